"""Inputs of networks relative to what was seen so far.

Mean and standard deviation are kept with the networks: they are saved, copied to target networks
and exported with them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from trocar.rl.features import GOALS, RELATIVE, STATE, Inputs


class Normalised(BaseFeaturesExtractor):
    """Inputs less their mean, by their standard deviation, clipped (as OpenAI baselines' HER).

    Achieved and desired goals have their statistics in common, so that they stay comparable. Before
    anything was seen, an array's bounds stand for them, and relative features, which are about 1,
    are left as they are. Stable-Baselines3 copies what is named ``running_…`` to target networks.
    """

    running_mean: torch.Tensor
    running_std: torch.Tensor
    seen_count: torch.Tensor
    seen_sum: torch.Tensor
    seen_square: torch.Tensor

    def __init__(
        self, space: spaces.Space[Any], *, inputs: Inputs, eps: float, clip: float
    ) -> None:
        """Of a task's observation space.

        Args:
            space: A Box, or a Dict of them.
            inputs: What is seen of observations.
            eps: Least standard deviation, in the units of each input.
            clip: Largest absolute value of a feature.
        """
        super().__init__(space, inputs.size)
        self.inputs = inputs
        self.eps, self.clip = eps, clip
        boxes = dict(space.spaces) if isinstance(space, spaces.Dict) else {STATE: space}
        ends = {
            key: torch.tensor(np.stack([box.low, box.high]))  # type: ignore[attr-defined]
            for key, box in boxes.items()
            if key in inputs.keys
        }
        unit = torch.tensor([[-2.0], [2.0]])
        low, high = torch.cat(
            [
                unit.expand(2, inputs.sizes[word]) if word == RELATIVE else inputs.part(word, ends)
                for word in inputs.words
            ],
            1,
        )
        self.register_buffer("running_mean", (low + high) / 2)
        self.register_buffer("running_std", ((high - low) / 4).clamp_min(eps))
        self.register_buffer("seen_count", torch.zeros(len(low), dtype=torch.float64))
        self.register_buffer("seen_sum", torch.zeros(len(low), dtype=torch.float64))
        self.register_buffer("seen_square", torch.zeros(len(low), dtype=torch.float64))

    def forward(self, observations: Any) -> torch.Tensor:
        """Features of shape (batch, numbers of the inputs)."""
        arrays = observations if isinstance(observations, Mapping) else {STATE: observations}
        features: torch.Tensor = (self.inputs(arrays) - self.running_mean) / self.running_std
        return features.clamp(-self.clip, self.clip)

    def see(self, observations: Mapping[str, NDArray[Any]] | NDArray[Any]) -> None:
        """Takes observations of shape (rows, …) into account, from the next :meth:`refresh` on."""
        arrays = observations if isinstance(observations, Mapping) else {STATE: observations}
        seen = {key: torch.as_tensor(arrays[key]) for key in (STATE, *GOALS) if key in arrays}
        for word, place in zip(self.inputs.words, self._places(), strict=True):
            both = GOALS if word in GOALS else (word,)
            rows = torch.cat([self.inputs.part(each, seen) for each in both]).double()
            self.seen_count[place] += len(rows)
            self.seen_sum[place] += rows.sum(0)
            self.seen_square[place] += rows.square().sum(0)

    def _places(self) -> list[slice]:
        """Where the numbers of each word are."""
        ends = np.cumsum([self.inputs.sizes[word] for word in self.inputs.words]).tolist()
        return [slice(start, end) for start, end in zip([0, *ends[:-1]], ends, strict=True)]

    def refresh(self) -> None:
        """Makes features relative to all that was seen."""
        if not bool(self.seen_count.all()):
            return
        mean = self.seen_sum / self.seen_count
        variance = (self.seen_square / self.seen_count - mean.square()).clamp_min(0.0)
        self.running_mean.copy_(mean)
        self.running_std.copy_(variance.sqrt().clamp_min(self.eps))
