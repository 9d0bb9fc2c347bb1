"""A curriculum from snapshots: where episodes begin, when they begin earlier, the same again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from trocar.rl import Config, Td3Demo, load, make_learner, train
from trocar.rl.curriculum import COUNTED, CurriculumVecEnv
from trocar.rl.demonstrations import expert
from trocar.rl.episodes import Episodes
from trocar.sb3 import make_vec

torch.set_num_threads(1)  # as training does

TASK = "MisOrient-v0"
DEMOS = 3
LEVELS = 3


SMALL: dict[str, Any] = {
    "hidden": [16],
    "epochs": 3,
    "epoch_episodes": 8,
    "eval_episodes": 2,
    "updates": 5,
    "demos": DEMOS,
    "batch_size": 64,
    "curriculum": LEVELS,
}


def config(**changes: Any) -> Config:
    return load(TASK, "her-demo").but(**(SMALL | {"demo_batch": 16} | changes))


@pytest.fixture(scope="module")
def demos(server: str) -> Episodes:
    return expert(config(), server)


@pytest.fixture
def envs(server: str, demos: Episodes) -> Iterator[CurriculumVecEnv]:
    made = make_vec(f"trocar/{TASK}", 2, server=server, expert=True)
    yield CurriculumVecEnv(made.envs, demos, config())
    made.close()


def test_episodes_go_on_as_the_demonstrations_did(envs: CurriculumVecEnv, demos: Episodes) -> None:
    assert [len(states) for states in envs.curriculum.ways] == [0, *[DEMOS] * (LEVELS - 1)]
    for number in range(DEMOS):
        (failing,) = np.nonzero(~demos.success[number])
        length = failing[-1] + 1
        assert 3 <= length < 50
        for level in range(1, LEVELS):
            now: Any = envs.envs.restore(envs.curriculum.ways[level][number], [1])
            begun = round(length * level / LEVELS)
            for step in range(begun, length):
                assert (now["observation"][1] == demos.observation[number, step]).all()
                envs.envs.send(demos.action[number, step][None], [1])
                envs.envs.recv()
                now = envs.envs.restore(envs.envs.snapshot([1]), [1])
            assert (now["achieved_goal"][1] == demos.achieved[number, length]).all()


def lengths(
    envs: CurriculumVecEnv, steps: int, act: Callable[[Any], NDArray[np.float32]]
) -> list[tuple[int, int]]:
    """Plays; the level and the length of each episode that ended."""
    envs.seed(5)
    envs.reset()
    infos: Any = [{"expert_action": np.zeros(1, np.float32)}] * 2
    found, begun, levels = [], [0, 0], [0, 0]
    for step in range(1, steps + 1):
        _, _, dones, infos = envs.step(act(infos))
        for row in np.flatnonzero(dones).tolist():
            found.append((levels[row], step - begun[row]))
            begun[row], levels[row] = step, envs.reset_infos[row]["level"]
    return found


def test_they_begin_earlier_when_enough_succeed(envs: CurriculumVecEnv) -> None:
    assert envs.curriculum.level == LEVELS - 1
    # A policy that does nothing never succeeds, and goes on beginning near the end.
    idle = lengths(envs, 2000, lambda _: np.zeros((2, 1), np.float32))
    assert envs.curriculum.level == LEVELS - 1
    assert {level for level, _ in idle[2:]} == {LEVELS - 1}
    assert all((length == 50) == (level == 0) for level, length in idle)
    # The expert does, although it acts a step late here.
    expert = lengths(envs, 4000, lambda infos: np.stack([info["expert_action"] for info in infos]))
    assert envs.curriculum.level == 0
    for level in range(1, LEVELS):
        # As many as count, and those that were under way when the last of them was.
        at_least = [begun for begun, _ in expert if begun >= level]
        assert len(at_least) >= COUNTED * (LEVELS - level)
    late = [level for level, _ in expert[-40:]]
    assert 0.5 < np.mean(np.equal(late, 0)) < 0.9
    assert {1, 2} <= {*late}


class Stop(Exception):
    pass


def stop(line: str) -> None:
    if "epoch   2" in line:
        raise Stop


def curve(config: Config, out: Path, server: str, say: Callable[[str], Any]) -> Rows:
    """The curve of a run, without the times that it took."""
    run = train(config, 1, out=out, server=server, resume=True, trust=True, say=say)
    rows = run.rows()
    return [{name: row[name] for name in row if not name.endswith("_s")} for row in rows]


Rows = list[dict[str, float]]

# It begins earlier whatever the policy does.
EARLIER = {"curriculum": LEVELS, "curriculum_success": 0.01, "random_actions": 1.0}
TD3: dict[str, Any] = {
    **EARLIER,
    "hidden": [16],
    "envs": 4,
    "epochs": 3,
    "epoch_episodes": 40,
    "eval_episodes": 2,
    "demos": DEMOS,
    "demo_batch": 8,
    "batch_size": 16,
    "updates": 1,
    "warm_up": 0,
    "clone_updates": 1,
    "critic_updates": 1,
    "train_every": 10,
    "enough": 0.0,
}


TD3_HER = {name: TD3[name] for name in TD3 if name not in ("demo_batch", "clone_updates")}


@pytest.mark.parametrize(
    "moves",
    [
        config(**EARLIER),
        load(TASK, "td3-demo").but(**TD3),
        load(TASK, "td3-her").but(**TD3_HER, learning_starts=200),
        load(TASK, "her").but(**(SMALL | EARLIER)),
    ],
)
def test_a_run_is_the_same_again_and_after_an_interruption(
    moves: Config, tmp_path: Path, server: str
) -> None:
    straight = curve(moves, tmp_path / "one", server, str)
    assert straight[0]["level"] == LEVELS - 1 > straight[-1]["level"]
    with pytest.raises(Stop):
        curve(moves, tmp_path / "two", server, stop)
    assert curve(moves, tmp_path / "two", server, str) == straight


def test_td3_begins_on_the_ways_of_demonstrations(server: str) -> None:
    moves = load(TASK, "td3-demo").but(**TD3)
    learner = make_learner(moves, expert(moves, server), 1, server=server)
    assert isinstance(learner, Td3Demo)
    assert learner.curriculum is not None
    learner.curriculum.level = 0  # half begin as the task's do, the others anywhere
    learner.learn(lambda _: None)
    replay, demos = learner.replay, learner.demos
    assert demos is not None
    first = replay.observation[: len(replay), 0]
    shown = {state.tobytes() for state in demos.observation.reshape(-1, first.shape[1])}
    later = replay.length[: len(replay)] < 50
    assert 5 <= later.sum() <= 25
    assert all(state.tobytes() in shown for state in first[later])
    assert learner.steps == replay.steps
    learner.close()


def test_levels_that_are_none_are_refused() -> None:
    with pytest.raises(ValueError, match="2 to 50"):
        config(curriculum=1)
    with pytest.raises(ValueError, match="curriculum_success"):
        config(curriculum_success=0.0)
    with pytest.raises(ValueError, match="demos"):
        load(TASK, "her").but(curriculum=3)  # begins on the ways of which demonstrations?
    with pytest.raises(ValueError, match="needs some for a curriculum"):
        load(TASK, "her").but(demos=3)
    with pytest.raises(ValueError, match="does not use it"):
        load(TASK, "dagger").but(curriculum=3)
    with pytest.raises(ValueError, match="no goals"):
        load("ActiveTrack", "ddpg").but(curriculum=3, demos=5)
