"""Relative features in a graph: by hand, and as the bindings compute them for every task."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

import trocar
from trocar.rl import BatchInputs, Inputs, Relative

ROUNDING = 1e-5
"""Of float32, for numbers of at most 3."""

TURNED = np.pi / 3


def computed(program: Sequence[dict[str, Any]], *x: float) -> NDArray[Any]:
    """The features of one row."""
    features = Relative(program, len(x))(torch.tensor([x]))
    assert features.shape == (1, Relative(program, len(x)).size)
    values: NDArray[Any] = features[0].numpy()
    return values


def offset(to: dict[str, Any], start: dict[str, Any], **changes: Any) -> dict[str, Any]:
    told = {"kind": "offset", "to": to, "from": start, "count": 2, "scale": 1.0}
    return told | {"bound": "clip"} | changes


def at(number: int) -> dict[str, Any]:
    return {"at": number}


def fixed(*numbers: float) -> dict[str, Any]:
    return {"fixed": [*numbers, 0.0, 0.0, 0.0][:3]}


def test_offsets_are_scaled_and_bounded() -> None:
    program = [
        offset(at(2), at(0), scale=0.1, bound="tanh"),
        offset(at(0), fixed(), scale=0.5),
        offset(at(2), fixed(1.0, 7.0), scale=-2.0),
        offset(at(1), fixed(0.5), count=1),
    ]
    near = np.tanh([20.0, -1.0])
    found = computed(program, 1.0, 4.0, 3.0, 3.9)
    assert found == pytest.approx([*near, 2.0, 3.0, -1.0, 1.55, 3.0], abs=ROUNDING)


def test_an_offset_may_be_told_between_points_of_what_is_turned() -> None:
    point = {"at": 3, "angles": 6, "offset": [0.0, 2.0, 0.5]}
    # Turned about z by 90°, y is -x.
    x = [1.0, 1.0, 1.0, 0.5, 0.25, 0.125, 0.0, 0.0, np.pi / 2]
    wanted = np.array([1.0 - 0.5 + 2.0, 1.0 - 0.25, 1.0 - 0.125 - 0.5])
    program = [
        offset(at(0), fixed(1.0), count=3),
        offset(at(0), point, count=3),
        offset(point, fixed(0.5, 0.5), count=3, scale=2.0),
        offset(point, point, count=3),
    ]
    found = computed(program, *x)
    other = (np.array([0.5, 0.5, 1.0]) - wanted) / 2.0
    assert found == pytest.approx([0, 1, 1, *wanted, *other, 0, 0, 0], abs=ROUNDING)


def test_rotations_are_two_columns_as_seen_from_another_frame() -> None:
    def turn(of: int, seen_from: int | None) -> dict[str, Any]:
        return {"kind": "rotation", "of": of, "seen_from": seen_from}

    # Turned about z by 60°; by 90° after rolling by 180°.
    x = [0.0, 0.0, TURNED, np.pi, 0.0, np.pi / 2]
    sin, cos = np.sin(TURNED), np.cos(TURNED)
    assert computed([turn(0, None)], *x) == pytest.approx([cos, sin, 0, -sin, cos, 0], abs=1e-6)
    # Rolling takes y to -y, and turning takes that to x.
    assert computed([turn(3, None)], *x) == pytest.approx([0, 1, 0, 1, 0, 0], abs=1e-6)
    assert computed([turn(3, 3), turn(0, 0)], *x) == pytest.approx([1, 0, 0, 0, 1, 0] * 2, abs=1e-6)
    # Seen from the first, both columns are turned back by 60°.
    seen = computed([turn(3, 0)], *x)
    assert seen == pytest.approx([sin, cos, 0, cos, -sin, 0], abs=1e-6)


def test_a_line_has_no_direction() -> None:
    line = {"kind": "line", "of": 3, "direction": [0.0, 1.0, 0.0], "seen_from": 0}
    frame = [0.3, -0.7, 1.1]
    # Yaw comes last, so half a turn of it takes a level frame's y to its opposite.
    wire = computed([line], *frame, 0.0, 0.0, 0.4)
    assert computed([line], *frame, 0.0, 0.0, 0.4 + np.pi) == pytest.approx(wire, abs=ROUNDING)
    assert computed([line], *frame, 0.0, 0.0, 1.4) != pytest.approx(wire, abs=0.1)
    # Seen from itself it is y: dy² is all that there is.
    assert computed([line], *frame, *frame) == pytest.approx([0, 0, 0, -1, 1], abs=ROUNDING)
    between = line | {"direction": [0.6, 0.0, 0.8]}
    wanted = [0, 0, 2 * 0.48, 0.36, -0.64]
    assert computed([between, line], *frame, *frame)[:5] == pytest.approx(wanted, abs=ROUNDING)


def drawn(spec: trocar.TaskSpec, rows: int) -> list[NDArray[np.float32]]:
    """States, achieved and desired goals, anywhere within their bounds."""
    random = np.random.default_rng(5)
    assert spec.goal is not None
    vectors = (spec.observation, spec.goal, spec.goal)
    return [
        np.stack([random.uniform(one.min, one.max, rows) for one in vector], 1).astype(np.float32)
        for vector in vectors
    ]


def test_the_graph_computes_what_the_bindings_compute(goal_task: str, server: str) -> None:
    envs = trocar.TrocarVectorEnv(goal_task, 1, server=server)
    envs.close()
    arrays = drawn(envs.task_spec, 300)
    wanted = BatchInputs(envs.task_spec, ("relative",))(*arrays)
    inputs = Inputs.of(envs.task_spec, ("relative",))
    names = ("observation", "achieved_goal", "desired_goal")
    found = inputs(dict(zip(names, map(torch.from_numpy, arrays), strict=True)))
    assert found.shape == (300, inputs.size)
    assert torch.allclose(found, wanted, atol=ROUNDING)
    assert (found.std(0) > 0).all()


def test_words_are_side_by_side(server: str) -> None:
    envs = trocar.TrocarVectorEnv("NeedlePick-v0", 1, server=server)
    envs.close()
    state, achieved, desired = drawn(envs.task_spec, 3)
    words = ("desired_goal", "observation")
    together = BatchInputs(envs.task_spec, words)(state, achieved, desired)
    assert together.numpy() == pytest.approx(np.concatenate([desired, state], 1))
    inputs = Inputs.of(envs.task_spec, words)
    assert inputs.keys == ["observation", "desired_goal"]
    arrays = {"observation": torch.from_numpy(state), "desired_goal": torch.from_numpy(desired)}
    assert torch.equal(inputs(arrays), together)
    with pytest.raises(ValueError, match="contact"):
        Inputs.of(envs.task_spec, ("relative", "contact"))
