"""Whole episodes: how they are played, kept, and drawn from with hindsight."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from trocar.demos import run
from trocar.rl import Episodes, play
from trocar.rl.episodes import Seen
from trocar.vector import TrocarVectorEnv

TASK = "NeedleReach-v0"
SEEDS = [11, 12, 13, 14]


@pytest.fixture
def envs(server: str) -> Iterator[TrocarVectorEnv]:
    made = TrocarVectorEnv(TASK, 4, server=server, autoreset_mode="disabled", expert=True)
    yield made
    made.close()


def as_expert(seen: Seen) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    return np.asarray(seen.infos["expert_action"])


def test_what_is_played_is_kept(envs: TrocarVectorEnv) -> None:
    calls: list[int] = []
    played = play(envs, as_expert, SEEDS, meanwhile=calls.append)
    assert calls == list(range(50))
    kept = Episodes.of(envs.task_spec, run(envs, SEEDS))
    for name in Episodes.NAMES:
        assert np.array_equal(getattr(played, name), getattr(kept, name)), name
    assert played.succeeded.all()
    assert (len(played), played.steps) == (4, 200)


def test_the_expert_labels_states_of_whatever_acts(envs: TrocarVectorEnv) -> None:
    played = play(envs, lambda seen: np.zeros((len(seen.envs), 5), np.float32), SEEDS)
    assert not played.succeeded.any()
    assert (played.action == 0).all()
    # It stays where it was, so the expert would always do the same.
    assert np.abs(played.label[:, :, :3]).max(axis=(1, 2)).min() > 0.2
    assert played.label[:, 1] == pytest.approx(played.label[:, 40], abs=1e-3)


def test_episodes_end_by_themselves(server: str) -> None:
    ends = TrocarVectorEnv(
        TASK, 4, server=server, autoreset_mode="disabled", expert=True, terminate="success"
    )
    played = play(ends, as_expert, SEEDS)
    assert (played.length < 50).all()
    assert len({*played.length.tolist()}) > 1
    for episode, length in enumerate(played.length):
        assert played.success[episode, length - 1]
        assert not played.success[episode, : length - 1].any()
        assert played.terminated[episode].sum() == 1
    drawn = played.sample(500, 0.0, ends, np.random.default_rng(0))
    assert np.array_equal(drawn.discount == 0, drawn.reward == 0)
    assert 0 < (drawn.discount == 0).sum() < 200
    ends.close()


def test_goals_are_reached_later_in_the_same_episode(envs: TrocarVectorEnv) -> None:
    random = np.random.default_rng(1)
    played = play(envs, lambda _: random.uniform(-1, 1, (4, 5)).astype(np.float32), SEEDS)
    drawn = played.sample(3000, 0.6, envs, random)
    changed = 0
    for row in range(3000):
        ((episode, time),) = np.argwhere((played.action == drawn.action[row]).all(axis=2))
        assert (drawn.observation[row] == played.observation[episode, time]).all()
        assert (drawn.next_observation[row] == played.observation[episode, time + 1]).all()
        goal = drawn.desired[row]
        if (goal != played.desired[episode]).any():
            changed += 1
            later = played.achieved[episode, time + 1 :]
            assert (later == goal).all(axis=1).any()
    assert 0.55 < changed / 3000 < 0.65
    assert (drawn.reward == envs.compute_reward(drawn.next_achieved, drawn.desired)).all()
    assert {*drawn.reward.tolist()} == {-1.0, 0.0}
    assert (drawn.discount == 1).all()
    plain = played.sample(500, 0.0, envs, random)
    assert (plain.reward == envs.compute_reward(plain.next_achieved, plain.desired)).all()


@pytest.mark.parametrize("terminate", ["", "success"])
def test_several_steps_count_until_the_episode_ends(terminate: str, server: str) -> None:
    options: dict[str, Any] = {"terminate": terminate} if terminate else {}
    envs = TrocarVectorEnv(
        TASK, 4, server=server, autoreset_mode="disabled", expert=True, **options
    )
    random = np.random.default_rng(1)

    def act(seen: Seen) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
        """The expert's actions, disturbed so that none is there twice."""
        return (as_expert(seen) + random.normal(0.0, 0.1, (len(seen.envs), 5))).astype(np.float32)

    played = play(envs, act, SEEDS)
    drawn = played.sample(1000, 0.5, envs, random, gamma=0.5, n_steps=3)
    fewer = 0
    for row in range(1000):
        ((episode, time),) = np.argwhere((played.action == drawn.action[row]).all(axis=2))
        total, discount = 0.0, 1.0
        for step in range(time, min(time + 3, played.length[episode])):
            reached = played.achieved[episode, step + 1]
            reward = float(envs.compute_reward(reached, drawn.desired[row]))
            total, discount = total + discount * reward, 0.5 * discount
            if terminate and reward == 0.0:
                discount = 0.0
                break
        fewer += step < time + 2
        assert drawn.reward[row] == total
        assert drawn.discount[row] == discount
        assert (drawn.next_observation[row] == played.observation[episode, step + 1]).all()
        assert (drawn.next_achieved[row] == played.achieved[episode, step + 1]).all()
    assert 20 < fewer < 500
    envs.close()


def test_the_latest_episodes_stay_and_every_step_is_as_likely(envs: TrocarVectorEnv) -> None:
    few = Episodes(envs.task_spec, 6)
    played = play(envs, as_expert, SEEDS)
    played.length[1] = 10
    few.add(played)
    few.add(play(envs, as_expert, [21, 22, 23, 24]))
    assert few.seed.tolist() == [23, 24, 13, 14, 21, 22]
    assert (few.count, len(few), few.steps) == (8, 6, 300)
    few.add(played, np.array([False, True, False, False]))
    assert few.seed.tolist() == [23, 24, 12, 14, 21, 22]
    episode, time = few.every_step()
    assert [(episode == row).sum() for row in range(6)] == [50, 50, 10, 50, 50, 50]
    assert time[episode == 2].tolist() == list(range(10))
    drawn = few.sample(26_000, 0.0, envs, np.random.default_rng(2))
    short = (drawn.desired == few.desired[2]).all(axis=1)
    assert 900 < short.sum() < 1100  # of 1000 on average, with a standard deviation of 31
    again = Episodes(envs.task_spec, 6)
    again.go_on(few.state())
    other = again.sample(26_000, 0.0, envs, np.random.default_rng(2))
    assert np.array_equal(drawn.observation, other.observation)
