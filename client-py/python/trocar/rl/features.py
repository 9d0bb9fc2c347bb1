"""What networks see: an observation as it is, or what is relative in it.

:func:`trocar.features` computes relative features of whole batches. :class:`Inputs` computes the
same as a part of a network, so that an exported policy has its features inside.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

import trocar
from trocar.errors import InvalidOption, refuse

STATE = "observation"
GOALS = ("achieved_goal", "desired_goal")
RELATIVE = "relative"
CONTACT = "contact"
WORDS = (STATE, *GOALS, RELATIVE, CONTACT)
"""What networks can see. ``relative`` is made from state and goals, ``contact`` is what follows the
state where the option ``observation`` has that word."""

LARGEST = 3.0
"""Where offsets are clipped that are not squashed."""

_CONTACT = re.compile(r"finger [12] (contact|force)$")
"""Names of what the word ``contact`` adds to an observation, after the state."""

Part = Mapping[str, Any]


class Relative(nn.Module):
    """Features of rows x by a program, which :attr:`trocar.TaskSpec.relative_program` describes.

    A row x is the state, the achieved and the desired goal. Parts of the same kind are computed
    together, and then put into the order of the program.

    Attributes:
        size: How many features there are.
    """

    end: torch.Tensor
    end_point: torch.Tensor
    start: torch.Tensor
    start_point: torch.Tensor
    fixed: torch.Tensor
    scale: torch.Tensor
    angles: torch.Tensor
    carriers: torch.Tensor
    levers: torch.Tensor
    turned: torch.Tensor
    seen_from: torch.Tensor
    rotations: torch.Tensor
    lines: torch.Tensor
    directions: torch.Tensor
    order: torch.Tensor

    def __init__(self, program: Sequence[Part], width: int) -> None:
        """Of a program for rows of ``width`` numbers."""
        super().__init__()
        kinds: dict[str, list[Part]] = {"clip": [], "tanh": [], "rotation": [], "line": []}
        places: dict[str, list[int]] = {kind: [] for kind in kinds}
        self.size = 0
        for part in program:
            kind = part.get("bound", part["kind"])
            count = {"rotation": 6, "line": 5}.get(kind) or int(part["count"])
            kinds[kind].append(part)
            places[kind] += range(self.size, self.size + count)
            self.size += count
        self._clipped = len(places["clip"])
        self._index("order", np.argsort([place for each in places.values() for place in each]))
        offsets, turns = kinds["clip"] + kinds["tanh"], kinds["rotation"] + kinds["line"]
        ends = [part[end] for part in offsets for end in ("to", "from")]
        points = list(dict.fromkeys(_point(place) for place in ends if "angles" in place))
        frames = [part[frame] for part in turns for frame in ("of", "seen_from")]
        frames = list(dict.fromkeys([*frames, *(angles for angles, *_ in points)]))
        # Whatever is missing is the column of zeros after those of x; points follow it.
        columns = [[width] * 3 if at is None else [at, at + 1, at + 2] for at in frames]
        self._index("angles", [column for each in columns for column in each])
        self._frames, self._turns, self._points = len(frames), len(turns), len(points)
        self._index("carriers", [frames.index(angles) for angles, *_ in points])
        self._numbers("levers", np.reshape([lever for _, *lever in points], (-1, 1, 3)))
        self._index("turned", [frames.index(part["of"]) for part in turns])
        self._index("seen_from", [frames.index(part["seen_from"]) for part in turns])
        self._index("rotations", range(len(kinds["rotation"])))
        self._index("lines", range(len(kinds["rotation"]), len(turns)))
        directions = [part["direction"] for part in kinds["line"]]
        self._numbers("directions", np.reshape(directions, (-1, 1, 3)))
        for name, end in (("end", "to"), ("start", "from")):
            told = [(part[end], step) for part in offsets for step in range(part["count"])]
            self._index(
                name, [place["at"] + step if "at" in place else width for place, step in told]
            )
            beyond = [
                width + 1 + 3 * points.index(_point(place)) + step if "angles" in place else width
                for place, step in told
            ]
            self._index(f"{name}_point", beyond)
        steps = [(part, step) for part in offsets for step in range(part["count"])]
        fixed = [_fixed(part["to"], step) - _fixed(part["from"], step) for part, step in steps]
        self._numbers("fixed", fixed)
        self._numbers("scale", [part["scale"] for part, _ in steps])

    def _index(self, name: str, numbers: Any) -> None:
        self.register_buffer(name, torch.tensor(numbers, dtype=torch.int64), persistent=False)

    def _numbers(self, name: str, numbers: Any) -> None:
        self.register_buffer(name, torch.tensor(numbers, dtype=torch.float32), persistent=False)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Features of shape (rows, :attr:`size`)."""
        x = torch.cat([x, x[:, :1] * 0.0], 1)
        turns = []
        if self._frames:
            axes = _axes(x.index_select(1, self.angles).reshape(-1, self._frames, 3))
            if self._turns:
                turns = self._turned(axes)
            if self._points:
                points = self.levers @ axes.index_select(1, self.carriers)
                x = torch.cat([x, points.flatten(1)], 1)
        # Numbers of x first: what is near each other is then told to a fraction of a micrometre.
        offsets = x.index_select(1, self.end) - x.index_select(1, self.start) + self.fixed
        beyond = x.index_select(1, self.end_point) - x.index_select(1, self.start_point)
        offsets = (offsets + beyond) / self.scale
        near = offsets[:, : self._clipped].clamp(-LARGEST, LARGEST)
        parts = [near, offsets[:, self._clipped :].tanh(), *turns]
        return torch.cat(parts, 1).index_select(1, self.order)

    def _turned(self, axes: torch.Tensor) -> list[torch.Tensor]:
        """All rotations, then all lines, of frames whose rows are their axes."""
        # Rows of a product are one frame's axes as seen from the other.
        seen_from = axes.index_select(1, self.seen_from).transpose(2, 3)
        seen = axes.index_select(1, self.turned) @ seen_from
        rotations = seen.index_select(1, self.rotations)[:, :, :2].flatten(1)
        lines = (self.directions @ seen.index_select(1, self.lines)).squeeze(2)
        dx, dy, dz = lines.unbind(2)
        products = [2 * dx * dy, 2 * dy * dz, 2 * dx * dz, dx * dx - dy * dy, dy * dy - dz * dz]
        return [rotations, torch.stack(products, 2).flatten(1)]


def _point(place: Part) -> tuple[Any, ...]:
    """The angles of what carries a place, and where that is in its axes."""
    return (place["angles"], *place["offset"])


def _fixed(place: Part, step: int) -> float:
    return float(place["fixed"][step]) if "fixed" in place else 0.0


def _axes(angles: torch.Tensor) -> torch.Tensor:
    """The axes, by row, of frames turned by roll, pitch and yaw about fixed axes x, y and z."""
    sin, cos = angles.sin(), angles.cos()
    sr, sp, sy = sin.unbind(2)
    cr, cp, cy = cos.unbind(2)
    x = torch.stack([cy * cp, sy * cp, -sp], 2)
    y = torch.stack([cy * sp * sr - sy * cr, sy * sp * sr + cy * cr, cp * sr], 2)
    z = torch.stack([cy * sp * cr + sy * sr, sy * sp * cr - cy * sr, cp * cr], 2)
    return torch.stack([x, y, z], 2)


class Inputs(nn.Module):
    """What a network sees, made from the arrays of an observation by their names.

    Attributes:
        keys: The arrays that are needed.
        size: How many numbers they become.
    """

    def __init__(
        self, words: Sequence[str], sizes: Mapping[str, int], program: Sequence[Part]
    ) -> None:
        """Of the words to be seen.

        Args:
            words: Some of :data:`WORDS`.
            sizes: Numbers of state, each goal, relative features and contact, by word.
            program: What computes relative features.
        """
        super().__init__()
        self.words, self.sizes, self.program = tuple(words), dict(sizes), list(program)
        width = sum(sizes[key] for key in (STATE, *GOALS))
        self.relative = Relative(program, width)
        needed = {
            *words,
            *((STATE, *GOALS) if RELATIVE in words else ()),
            *([STATE] if CONTACT in words else ()),
        }
        self.keys = [key for key in (STATE, *GOALS) if key in needed]
        self.size = sum(sizes[word] for word in words)

    @classmethod
    def of(cls, spec: trocar.TaskSpec, words: Sequence[str]) -> Inputs:
        """Of a task.

        Raises:
            ValueError: The task has no such word.
        """
        sizes, program = _described(spec)
        for word in words:
            if sizes.get(word, 0) == 0:
                allowed = f"{spec.id} has {[word for word, size in sizes.items() if size]}"
                raise refuse(InvalidOption, "inputs", word, allowed)
        return cls(words, sizes, program)

    def forward(self, arrays: Mapping[str, torch.Tensor]) -> torch.Tensor:
        """Numbers of shape (rows, :attr:`size`) of arrays of shape (rows, …), by their names."""
        return torch.cat([self.part(word, arrays) for word in self.words], 1)

    def part(self, word: str, arrays: Mapping[str, torch.Tensor]) -> torch.Tensor:
        """The numbers of one word."""
        if word in GOALS:
            return arrays[word]
        state = arrays[STATE][:, : self.sizes[STATE]]
        if word == RELATIVE:
            x = torch.cat([state, *(arrays[goal] for goal in GOALS)], 1)
            features: torch.Tensor = self.relative(x)
            return features
        return arrays[STATE][:, self.sizes[STATE] :] if word == CONTACT else state


class BatchInputs:
    """The same as :class:`Inputs`, of a whole batch of arrays in one call of the bindings."""

    def __init__(self, spec: trocar.TaskSpec, words: Sequence[str]) -> None:
        self.spec, self.words = spec, tuple(words)
        self.state = _described(spec)[0][STATE]

    def __call__(
        self, observation: NDArray[Any], achieved: NDArray[Any], desired: NDArray[Any]
    ) -> torch.Tensor:
        """Numbers of shape (rows, …) of arrays of shape (rows, …)."""
        state = observation[:, : self.state]
        goals = dict(zip(GOALS, (achieved, desired), strict=True))
        arrays = {STATE: state, CONTACT: observation[:, self.state :], **goals}
        if RELATIVE in self.words:
            arrays[RELATIVE] = trocar.features(state, achieved, desired, task=self.spec)
        return torch.from_numpy(np.concatenate([arrays[word] for word in self.words], 1))


def _described(spec: trocar.TaskSpec) -> tuple[dict[str, int], list[Part]]:
    """How many numbers each word means in a task, and what computes its relative features."""
    goal = len(spec.goal or [])
    contact = sum(bool(_CONTACT.search(element.name)) for element in spec.observation)
    sizes = {STATE: len(spec.observation) - contact, **dict.fromkeys(GOALS, goal)}
    return sizes | {RELATIVE: len(spec.relative), CONTACT: contact}, list(spec.relative_program)
