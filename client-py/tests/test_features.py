"""Relative features: those of the environment, for any batch and other goals."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from numpy.typing import NDArray

import trocar
from trocar import TrocarVectorEnv
from trocar.registration import TAGS, TASKS

GOAL_TASKS = [task for task in TASKS if "endless" not in TAGS[task]]


def reference(program: list[dict[str, Any]], x: NDArray[np.float64]) -> NDArray[np.float64]:
    """What :attr:`TaskSpec.relative_program` says, written down once more."""

    def turn(at: int) -> NDArray[np.float64]:
        (sr, sp, sy), (cr, cp, cy) = np.sin(x[at : at + 3]), np.cos(x[at : at + 3])
        yaw = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
        pitch = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
        roll = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
        return yaw @ pitch @ roll  # type: ignore[no-any-return]

    def place(told: dict[str, Any]) -> NDArray[np.float64]:
        if "fixed" in told:
            return np.array(told["fixed"])
        at = x[told["at"] : told["at"] + 3]
        return at + turn(told["angles"]) @ told["offset"] if "angles" in told else at

    rows = []
    for told in program:
        if told["kind"] == "offset":
            ends = [place(told[end])[: told["count"]] for end in ("to", "from")]
            offset = (ends[0] - ends[1]) / told["scale"]
            rows.append(np.clip(offset, -3, 3) if told["bound"] == "clip" else np.tanh(offset))
            continue
        of = turn(told["of"])
        seen = of if told["seen_from"] is None else turn(told["seen_from"]).T @ of
        if told["kind"] == "rotation":
            rows.append(np.concatenate([seen[:, 0], seen[:, 1]]))
        else:
            dx, dy, dz = seen @ told["direction"]
            rows.append(
                np.array([2 * dx * dy, 2 * dy * dz, 2 * dx * dz, dx**2 - dy**2, dy**2 - dz**2])
            )
    return np.concatenate(rows)


@pytest.mark.parametrize("task", GOAL_TASKS)
def test_features_of_random_states_and_goals(task: str, server: str) -> None:
    envs = TrocarVectorEnv(task, 2, server=server)
    spec = envs.task_spec
    low, high = np.array([(e.min, e.max) for e in spec.observation], np.float32).T
    rng = np.random.default_rng(0)
    states = rng.uniform(low, high, (3, 5, len(low))).astype(np.float32)
    assert spec.goal is not None
    low, high = np.array([(e.min, e.max) for e in spec.goal], np.float32).T
    achieved, desired = rng.uniform(low, high, (2, 3, 5, len(low))).astype(np.float32)
    features = trocar.features(states, achieved, desired, task=envs)
    assert features.shape == (3, 5, len(spec.relative))
    x = np.concatenate([states, achieved, desired], -1).astype(np.float64)
    for index in np.ndindex(3, 5):
        row = features[index]
        np.testing.assert_allclose(row, reference(spec.relative_program, x[index]), atol=1e-6)
        alone = trocar.features(states[index], achieved[index], desired[index], task=spec)
        np.testing.assert_array_equal(row, alone)
    envs.close()


@pytest.mark.parametrize("task", GOAL_TASKS)
def test_an_environment_shows_the_same_bits(task: str, server: str) -> None:
    words: dict[str, Any] = {
        "observation": ("state", "relative"),
        "domain": {"observation_noise": (1e-3, 1e-3)},
    }
    if task in ("EcmReach-v0", "MisOrient-v0", "StaticTrack-v0"):
        del words["domain"]
    envs = TrocarVectorEnv(task, 4, server=server, **words)
    features = len(envs.task_spec.relative)
    observation, _ = envs.reset(seed=0)
    envs.action_space.seed(0)
    for _ in range(10):
        assert envs.observation_space.contains(observation)
        state, shown = np.split(observation["observation"], [-features], axis=-1)
        goals = observation["achieved_goal"], observation["desired_goal"]
        np.testing.assert_array_equal(shown, trocar.features(state, *goals, task=envs))
        observation, *_ = envs.step(envs.action_space.sample())
    envs.close()


def test_what_is_no_state_is_refused(server: str) -> None:
    env: Any = gym.make("trocar/NeedlePick-v0", server=server)
    state, goal = np.zeros((2, 19)), np.zeros((2, 3))
    assert trocar.features(state, goal, goal, task=env).shape[0] == 2
    for wrong in ((state[:, :7], goal, goal), (state, goal[:1], goal), (state, goal, goal[:, :2])):
        with pytest.raises(ValueError, match="expected shape"):
            trocar.features(*wrong, task=env)
    with pytest.raises(ValueError, match="task"):
        trocar.features(state, goal, goal, task="NeedlePick")
    env.close()
    track: Any = gym.make("trocar/ActiveTrack-v0", server=server)
    with pytest.raises(trocar.errors.Unsupported, match="no relative features"):
        trocar.features(np.zeros(10), np.zeros(0), np.zeros(0), task=track)
    track.close()
