"""Inputs of networks relative to what was seen so far.

Mean and standard deviation are kept with the networks: they are saved, copied to target networks
and exported with them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

GOALS = ("achieved_goal", "desired_goal")


class Normalised(BaseFeaturesExtractor):
    """Inputs less their mean, by their standard deviation, clipped (as OpenAI baselines' HER).

    Achieved and desired goals have their statistics in common, so that they stay comparable. Before
    anything was seen, an input's bounds stand for them. Stable-Baselines3 copies what is named
    ``running_…`` to target networks.
    """

    running_mean: torch.Tensor
    running_std: torch.Tensor
    seen_count: torch.Tensor
    seen_sum: torch.Tensor
    seen_square: torch.Tensor

    def __init__(
        self, space: spaces.Space[Any], *, inputs: Sequence[str], eps: float, clip: float
    ) -> None:
        """Of a task's observation space.

        Args:
            space: A Box, or a Dict of them.
            inputs: The keys of a Dict that are inputs.
            eps: Least standard deviation, in the units of each input.
            clip: Largest absolute value of a feature.
        """
        boxes = dict(space.spaces) if isinstance(space, spaces.Dict) else {"observation": space}
        self.keys = [key for key in inputs if key in boxes]
        chosen = [boxes[key] for key in self.keys]
        super().__init__(space, sum(spaces.flatdim(box) for box in chosen))
        self.is_dict = isinstance(space, spaces.Dict)
        self.eps, self.clip = eps, clip
        low, high = (
            np.concatenate([np.asarray(getattr(box, end)).ravel() for box in chosen])
            for end in ("low", "high")
        )
        self.register_buffer("running_mean", torch.as_tensor((low + high) / 2))
        self.register_buffer("running_std", torch.as_tensor((high - low) / 4).clamp_min(eps))
        self.register_buffer("seen_count", torch.zeros(len(low), dtype=torch.float64))
        self.register_buffer("seen_sum", torch.zeros(len(low), dtype=torch.float64))
        self.register_buffer("seen_square", torch.zeros(len(low), dtype=torch.float64))

    def forward(self, observations: Any) -> torch.Tensor:
        """Features of shape (batch, sum of the inputs' dimensions)."""
        if self.is_dict:
            values = torch.cat([observations[key] for key in self.keys], dim=1)
        else:
            values = observations
        features = (values - self.running_mean) / self.running_std
        return features.clamp(-self.clip, self.clip)

    def see(self, observations: Mapping[str, NDArray[Any]] | NDArray[Any]) -> None:
        """Takes observations of shape (rows, …) into account, from the next :meth:`refresh` on."""
        parts = []
        for key in self.keys:
            if not isinstance(observations, Mapping):
                rows = observations
            elif key in GOALS:
                rows = np.concatenate([observations[goal] for goal in GOALS])
            else:
                rows = observations[key]
            rows = rows.astype(np.float64)
            count = np.full(rows.shape[1], len(rows), np.float64)
            parts.append((count, rows.sum(axis=0), np.square(rows).sum(axis=0)))
        totals = (self.seen_count, self.seen_sum, self.seen_square)
        for total, seen in zip(totals, zip(*parts, strict=True), strict=True):
            total += torch.as_tensor(np.concatenate(seen))

    def refresh(self) -> None:
        """Makes features relative to all that was seen."""
        if not bool(self.seen_count.all()):
            return
        mean = self.seen_sum / self.seen_count
        variance = (self.seen_square / self.seen_count - mean.square()).clamp_min(0.0)
        self.running_mean.copy_(mean)
        self.running_std.copy_(variance.sqrt().clamp_min(self.eps))
