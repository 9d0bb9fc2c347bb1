"""What networks see: an observation as it is, or what is relative in it.

:func:`trocar.features` computes relative features of whole batches. :class:`Inputs` computes the
same as a part of a network, so that an exported policy has its features inside.
"""

from __future__ import annotations

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

Part = Mapping[str, Any]


class Relative(nn.Module):
    """Features of rows x by a program, which :attr:`trocar.TaskSpec.relative_program` describes.

    A row x is the state, the achieved and the desired goal. Parts of the same kind are computed
    together, and then put into the order of the program.

    Attributes:
        size: How many features there are.
    """

    end: torch.Tensor
    start: torch.Tensor
    shift: torch.Tensor
    fixed: torch.Tensor
    scale: torch.Tensor
    angles: torch.Tensor
    levers: torch.Tensor
    carriers: torch.Tensor
    turned: torch.Tensor
    seen_from: torch.Tensor
    firsts: torch.Tensor
    alone: torch.Tensor
    order: torch.Tensor

    def __init__(self, program: Sequence[Part], width: int) -> None:
        """Of a program for rows of ``width`` numbers."""
        super().__init__()
        kinds: dict[str, list[Part]] = {"clip": [], "tanh": [], "rotation": [], "axis": []}
        places: dict[str, list[int]] = {kind: [] for kind in kinds}
        self.size = 0
        for part in program:
            kind = part.get("bound", part["kind"])
            count = {"rotation": 6, "axis": 5}.get(kind) or int(part["count"])
            kinds[kind].append(part)
            places[kind] += range(self.size, self.size + count)
            self.size += count
        self._clipped = len(places["clip"])
        self._index("order", np.argsort([place for each in places.values() for place in each]))
        offsets, rotations, axes = kinds["clip"] + kinds["tanh"], kinds["rotation"], kinds["axis"]
        frames = self._turns_of(rotations, axes)
        points = list(dict.fromkeys(_point(part) for part in offsets if part["angles"] is not None))
        carriers = [angles for angles, *_ in points]
        frames += [angles for angles in dict.fromkeys(carriers) if angles not in frames]
        self._frames_of(frames, width)
        self._points = len(points)
        self._index("carriers", [frames.index(angles) for angles in carriers])
        self._numbers("levers", np.reshape([lever for _, *lever in points], (-1, 1, 3)))
        self._offsets_of(offsets, points, width)

    def _offsets_of(self, offsets: list[Part], points: list[Any], width: int) -> None:
        end, start, shift, fixed, scale = [], [], [], [], []
        for part in offsets:
            point = None if part["angles"] is None else width + 1 + 3 * points.index(_point(part))
            for step in range(part["count"]):
                end.append(part["to"] + step)
                # Whatever is missing is the column of zeros after those of x; points follow it.
                start.append(width if part["from"] is None else part["from"] + step)
                shift.append(width if point is None else point + step)
                fixed.append(0.0 if part["fixed"] is None else part["fixed"][step])
                scale.append(part["scale"])
        for name, places in (("end", end), ("start", start), ("shift", shift)):
            self._index(name, places)
        self._numbers("fixed", fixed)
        self._numbers("scale", scale)

    def _turns_of(self, rotations: list[Part], axes: list[Part]) -> list[int | None]:
        """The frames in which something is turned; ``None`` is that of the scene."""
        pairs = [(part["of"], part["seen_from"]) for part in rotations + axes]
        frames: list[int | None] = list(dict.fromkeys(frame for pair in pairs for frame in pair))
        self._turned = len(pairs)
        self._index("turned", [frames.index(turned) for turned, _ in pairs])
        self._index("seen_from", [frames.index(seen_from) for _, seen_from in pairs])
        self._index("firsts", [3 * row + axis for row in range(len(rotations)) for axis in (0, 1)])
        alone = [3 * (len(rotations) + row) + part["axis"] for row, part in enumerate(axes)]
        self._index("alone", alone)
        return frames

    def _frames_of(self, frames: list[int | None], width: int) -> None:
        columns = [[width] * 3 if at is None else [at, at + 1, at + 2] for at in frames]
        self._frames = len(frames)
        self._index("angles", [column for each in columns for column in each])

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
            if self._turned:
                turns = self._turns(axes)
            if self._points:
                x = torch.cat(
                    [x, (self.levers @ axes.index_select(1, self.carriers)).flatten(1)], 1
                )
        # Places less places first: what is near is told to a fraction of a micrometre.
        offsets = x.index_select(1, self.end) - x.index_select(1, self.start) - self.fixed
        offsets = (offsets - x.index_select(1, self.shift)) / self.scale
        near = offsets[:, : self._clipped].clamp(-LARGEST, LARGEST)
        parts = [near, offsets[:, self._clipped :].tanh(), *turns]
        return torch.cat(parts, 1).index_select(1, self.order)

    def _turns(self, axes: torch.Tensor) -> list[torch.Tensor]:
        """All rotations, then all single axes, of frames whose rows are their axes."""
        # Rows of a product are one frame's axes as seen from the other.
        seen_from = axes.index_select(1, self.seen_from).transpose(2, 3)
        seen = axes.index_select(1, self.turned) @ seen_from
        seen = seen.reshape(-1, 3 * self._turned, 3)
        dx, dy, dz = seen.index_select(1, self.alone).unbind(2)
        products = [2 * dx * dy, 2 * dy * dz, 2 * dx * dz, dx * dx - dy * dy, dy * dy - dz * dz]
        firsts = seen.index_select(1, self.firsts)
        return [firsts.flatten(1), torch.stack(products, 2).flatten(1)]


def _point(part: Part) -> tuple[Any, ...]:
    """The angles of what carries an offset's origin, and where that is in its axes."""
    return (part["angles"], *part["offset"])


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
    contact = sum("finger " in element.name for element in spec.observation)
    sizes = {STATE: len(spec.observation) - contact, **dict.fromkeys(GOALS, goal)}
    return sizes | {RELATIVE: len(spec.relative), CONTACT: contact}, list(spec.relative_program)
