"""The networks of :mod:`trocar.rl`'s own algorithms: a policy that acts, and critics that rate."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from trocar.rl.features import GOALS, STATE, Inputs


class Normal(nn.Module):
    """Features less their mean, by their standard deviation, clipped."""

    mean: torch.Tensor
    std: torch.Tensor

    def __init__(self, size: int, clip: float) -> None:
        super().__init__()
        self.clip = clip
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("std", torch.ones(size))

    def fit(self, features: torch.Tensor, eps: float) -> None:
        """Takes mean and standard deviation (at least ``eps``) of rows of features."""
        self.mean.copy_(features.mean(0))
        self.std.copy_(features.std(0, correction=0).clamp_min(eps))

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """Features of the same shape."""
        return ((features - self.mean) / self.std).clamp(-self.clip, self.clip)


class Policy(nn.Module):
    """A deterministic policy: features to an action in [-1, 1].

    It also acts on observations as environments give them, as Stable-Baselines3's models do.
    """

    def __init__(self, inputs: Inputs, actions: int, hidden: Sequence[int], clip: float) -> None:
        """Untrained, for actions of ``actions`` numbers."""
        super().__init__()
        self.inputs = inputs
        self.built_from: dict[str, Any] = {"actions": actions, "hidden": list(hidden), "clip": clip}
        self.normal = Normal(inputs.size, clip)
        self.layers = _layers([inputs.size, *hidden, actions], layer_norm=False)

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """Actions of shape (rows, action dim) for features of :attr:`inputs`."""
        action: torch.Tensor = self.layers(self.normal(features)).tanh()
        return action

    def act(
        self, observation: NDArray[Any], achieved: NDArray[Any], desired: NDArray[Any]
    ) -> NDArray[np.float32]:
        """Actions for rows of states and goals."""
        arrays = dict(zip((STATE, *GOALS), (observation, achieved, desired), strict=True))
        return self.predict(arrays)[0]

    def predict(
        self, observation: Any, /, *, deterministic: bool = True
    ) -> tuple[NDArray[np.float32], None]:
        """Actions for observations of several environments."""
        del deterministic
        arrays = observation if isinstance(observation, Mapping) else {STATE: observation}
        with torch.no_grad():
            rows = {key: torch.from_numpy(arrays[key]) for key in self.inputs.keys}
            action: NDArray[np.float32] = self(self.inputs(rows)).numpy()
        return action, None

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes all that :meth:`load` needs."""
        inputs = {
            "words": self.inputs.words,
            "sizes": self.inputs.sizes,
            "program": self.inputs.program,
        }
        torch.save(
            {"inputs": inputs, "policy": self.built_from, "weights": self.state_dict()}, path
        )

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Policy:
        """The policy that :meth:`save` wrote."""
        told = torch.load(path, weights_only=True)
        policy = cls(Inputs(**told["inputs"]), **told["policy"])
        policy.load_state_dict(told["weights"])
        return policy


class Critics(nn.Module):
    """Several critics, each with layer normalisation, which keeps values of unseen actions small.

    Source: Ball et al., Efficient Online Reinforcement Learning with Offline Data, ICML 2023.
    """

    def __init__(self, policy: Policy, hidden: Sequence[int], count: int, first: float) -> None:
        """Of a policy's features and actions; all values are about ``first`` at first."""
        super().__init__()
        self.normal = policy.normal
        sizes = [policy.inputs.size + policy.built_from["actions"], *hidden, 1]
        self.each = nn.ModuleList(_layers(sizes, layer_norm=True) for _ in range(count))
        for layers in self.each:
            nn.init.constant_(layers[-1].bias, first)  # type: ignore[index]

    def forward(self, features: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
        """Values of shape (critics, rows)."""
        rows = torch.cat([self.normal(features), 2.0 * actions], 1)
        return torch.stack([layers(rows).squeeze(1) for layers in self.each])


def _layers(sizes: Sequence[int], *, layer_norm: bool) -> nn.Sequential:
    layers: list[nn.Module] = []
    for width, following in pairwise(sizes[:-1]):
        layers += [
            nn.Linear(width, following),
            *([nn.LayerNorm(following)] if layer_norm else []),
            nn.ReLU(),
        ]
    return nn.Sequential(*layers, nn.Linear(sizes[-2], sizes[-1]))
