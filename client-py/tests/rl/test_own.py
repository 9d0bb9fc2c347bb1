"""Cloning, DAgger and TD3: losses on cases with known answers, and what each of them learns."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from trocar.demos import record
from trocar.rl import Config, Critics, Policy, Run, Td3Demo, load, make_learner, score, train
from trocar.rl.demonstrations import expert, recorded
from trocar.rl.imitation import labelled
from trocar.rl.td3 import Batch
from trocar.sb3 import make_vec

# Threads that wait for each other by turning take longer than one, on a machine that is busy.
torch.set_num_threads(1)

REACH: dict[str, Any] = {
    "hidden": [64, 64],
    "envs": 10,
    "epochs": 3,
    "epoch_episodes": 20,
    "eval_episodes": 20,
    "batch_size": 128,
    "averaging": 0.02,
    "critic_updates": 50,
}
"""NeedleReach in seconds."""


def quietly(line: str) -> None:
    del line


def config(algo: str, task: str = "NeedleReach", /, **changes: Any) -> Config:
    known = load(task, algo)
    mine = {name: value for name, value in REACH.items() if algo.startswith("td3")}
    return known.but(**(mine | changes))


@pytest.fixture
def learner(server: str) -> Iterator[Td3Demo]:
    """With gamma 0.5, so that no return is below -2."""
    small = {"gamma": 0.5, "hidden": [8], "demos": 2, "demo_batch": 4, "target_noise": 0.0}
    few = {"batch_size": 8, "clone_updates": 5, "critic_updates": 5, "updates": 1}
    chosen = config("td3-demo", "MisOrient", **(small | few))
    made = make_learner(chosen, expert(chosen, server), 0, server=server)
    assert isinstance(made, Td3Demo)
    yield made
    made.close()


def acts(policy: Policy, action: float) -> None:
    """Lets a policy do the same in every state."""
    with torch.no_grad():
        for weights in policy.parameters():
            weights.zero_()
        policy.layers[-1].bias.fill_(float(np.arctanh(action)))  # type: ignore[operator]


def rates(critics: Critics, *slopes: float) -> None:
    """Lets each critic rate an action by its own slope, as long as hidden units are left as is."""

    class Slope(torch.nn.Module):
        def __init__(self, slope: float) -> None:
            super().__init__()
            self.slope = torch.nn.Parameter(torch.tensor(slope))

        def forward(self, rows: torch.Tensor) -> torch.Tensor:
            return self.slope * rows[:, -1:] / 2

    critics.each = torch.nn.ModuleList(map(Slope, slopes))


def batch(actions: list[float], rewards: list[float], discount: list[float], shown: int) -> Batch:
    features = torch.zeros(len(actions), FEATURES)
    column = torch.tensor(actions)[:, None]
    rest = torch.tensor(rewards), features, torch.tensor(discount)
    return Batch(features, column, column, *rest, shown)


BOTH = [0, 1]
"""Critics that rate."""

FEATURES = 10
"""Of the fixture's inputs: state and desired goal of MisOrient."""


@pytest.fixture
def raw(server: str) -> Iterator[Td3Demo]:
    """A learner with raw inputs."""
    small = {"gamma": 0.5, "hidden": [8], "demos": 2, "demo_batch": 4, "target_noise": 0.0}
    more = {"batch_size": 8, "inputs": ["observation", "desired_goal"]}
    chosen = config("td3-demo", "MisOrient", **(small | more))
    made = make_learner(chosen, expert(chosen, server), 0, server=server)
    assert isinstance(made, Td3Demo)
    yield made
    made.close()


def test_targets_are_the_least_of_possible_returns(raw: Td3Demo) -> None:
    acts(raw.target, 0.8)
    rates(raw.critics, 1.0, 0.0)
    rates(raw.target_critics, 1.0, 2.0)
    cases = batch([0.0, 0.0, 0.5], [-1.0, -1.0, 0.0], [0.5, 0.0, 0.5], 0)
    # Targets: -1 + 0.5 · 0.8, -1 at the end, and 0, since 0.4 is above what is possible.
    loss, values = raw.critic_loss(cases, BOTH)
    assert loss.item() == pytest.approx((2 * 0.6**2 + 2 * 1 + 0.5**2) / 3, rel=1e-5)
    assert values.tolist() == pytest.approx([0.0, 0.0, 0.0])
    rates(raw.target_critics, 1.0, -50.0)
    loss, _ = raw.critic_loss(cases, BOTH)
    assert loss.item() == pytest.approx((2 * 4 + 2 * 1 + 2.5**2 + 4) / 3, rel=1e-5)


def test_two_of_many_critics_rate_a_batch(raw: Td3Demo) -> None:
    object.__setattr__(raw.config, "critics", 4)
    acts(raw.target, 0.8)
    acts(raw.policy, 0.4)
    rates(raw.critics, 0.0, 1.0, 2.0, 3.0)
    rates(raw.target_critics, 0.0, -1.0, -2.0, 1.0)
    cases = batch([0.5], [-1.0], [0.5], 0)
    # Targets of two: -1 + 0.5 · (-1.6), and -1 + 0.5 · (-0.8). All are trained towards them.
    for pair, target, value in ([2, 3], -1.8, 1.0), ([1, 3], -1.4, 0.5):
        loss, values = raw.critic_loss(cases, pair)
        off = [(0.5 * slope - target) ** 2 for slope in range(4)]
        assert loss.item() == pytest.approx(sum(off), rel=1e-5)
        assert values.tolist() == pytest.approx([value])
        assert raw.policy_loss(cases, values, 1.0, pair)[0].item() == pytest.approx(-0.4 * pair[0])
    drawn = {tuple(sorted(raw._pair())) for _ in range(200)}
    assert drawn == set(combinations(range(4), 2))


def test_targets_are_smoothed(raw: Td3Demo) -> None:
    object.__setattr__(raw.config, "target_noise", 0.2)
    acts(raw.target, 0.0)
    rates(raw.critics, 0.0, 0.0)
    rates(raw.target_critics, 1.0, 1.0)
    many = batch([0.0] * 4000, [-1.0] * 4000, [0.5] * 4000, 0)
    loss, _ = raw.critic_loss(many, BOTH)
    # The mean square of -1 + 0.5 · noise is 1.008 or a little more, give or take 0.003.
    assert 1.003 < loss.item() / 2 < 1.016


@pytest.mark.parametrize("q_filter", [True, False])
def test_only_actions_that_are_rated_higher_are_cloned(raw: Td3Demo, q_filter: bool) -> None:
    object.__setattr__(raw.config, "q_filter", q_filter)
    acts(raw.policy, 0.3)
    rates(raw.critics, 1.0, 2.0)
    shown = [0.5, 0.9, 0.2, -0.7]
    cases = batch([*shown, 0.1, 0.1], [-1.0] * 6, [1.0] * 6, 4)
    _, values = raw.critic_loss(cases, BOTH)
    assert values.tolist() == pytest.approx([0.5, 0.9, 0.2, -1.4, 0.1, 0.1])
    loss, clone, passed = raw.policy_loss(cases, values, 0.5, BOTH)
    passing = shown[:2] if q_filter else shown
    wanted = sum(abs(0.3 - action) for action in passing) / 4
    assert clone.item() == pytest.approx(wanted, rel=1e-4)
    assert passed.item() == len(passing) / 4
    assert loss.item() == pytest.approx(-0.5 * 0.3 + 4.0 * wanted, rel=1e-4)


def test_networks_follow_each_at_its_pace(raw: Td3Demo) -> None:
    for name, value in (("tau", 0.25), ("averaging", 0.5), ("policy_every", 2)):
        object.__setattr__(raw.config, name, value)
    before = {name: list(map(torch.clone, getattr(raw, name).parameters())) for name in FOLLOWS}
    raw.update(1.0)
    for name, source, part in (("target_critics", "critics", 0.25), ("target", "policy", 0.0)):
        check_followed(raw, before, name, source, part)
    raw.update()
    check_followed(raw, before, "averaged", "policy", 0.0)
    raw.update(1.0)
    raw.update(1.0)
    check_followed(raw, before, "averaged", "policy", 0.5)
    check_followed(raw, before, "target", "policy", 0.25)
    assert raw.acting is raw.averaged


FOLLOWS = ("target_critics", "target", "averaged", "policy")


def check_followed(learner: Td3Demo, before: Any, name: str, source: str, part: float) -> None:
    now = getattr(learner, source).parameters()
    for old, weights, moved in zip(
        before[name], now, getattr(learner, name).parameters(), strict=True
    ):
        assert torch.allclose(moved, old + part * (weights - old), atol=1e-6)


def test_critics_count_ever_more(raw: Td3Demo) -> None:
    found = []
    for name, value in (("warm_up", 20), ("ramp", 40), ("policy_weight", 0.5)):
        object.__setattr__(raw.config, name, value)
    for count in (0, 10, 20, 40, 50, 500):
        raw.replay.count = count
        found.append(raw.weight())
    assert found == pytest.approx([0.0, 0.0, 0.125, 0.375, 0.5, 0.5])


def test_half_of_a_batch_is_shown(learner: Td3Demo) -> None:
    assert learner.demos is not None
    shown = {action.tobytes() for action in learner.demos.action.reshape(-1, 1)}
    drawn = learner.batch()
    assert (drawn.shown, len(drawn.features)) == (8, 8)  # nothing was played
    learner.begin(lambda _: None)
    learner.learn(lambda _: None)
    drawn = learner.batch()
    assert drawn.shown == 4
    own = [action.numpy().tobytes() in shown for action in drawn.action]
    assert own[:4] == [True] * 4
    assert not all(own[4:])


def test_what_succeeds_becomes_a_demonstration(server: str) -> None:
    few = {"demos": 5, "demo_batch": 64, "clone_updates": 500, "own_demos": True, "updates": 1}
    chosen = config("td3-demo", **few, noise=0.3)
    shown = expert(chosen, server)
    mine, other = (make_learner(chosen, shown, 0, server=server) for _ in range(2))
    assert isinstance(mine, Td3Demo)
    assert isinstance(other, Td3Demo)
    assert mine.demos is not None
    assert other.demos is not None
    mine.begin(lambda _: None)
    mine.learn(lambda _: None)
    succeeded = mine.replay.succeeded
    assert 0 < succeeded.sum() < 20
    seeds = [*shown.seed.tolist(), *mine.replay.seed[:20][succeeded].tolist()]
    assert mine.demos.seed[: len(mine.demos)].tolist() == seeds
    assert len(shown) == 5
    other.go_on(mine.state())
    assert len(other.demos) == len(seeds)
    assert torch.equal(mine.batch().features, other.batch().features)
    assert torch.equal(mine.batch().reward, other.batch().reward)
    mine.close()
    other.close()


def test_cloning_learns_from_demonstrations_alone(tmp_path: Path, server: str) -> None:
    few = {"demos": 100, "clone_updates": 3000, "hidden": [128, 128], "eval_episodes": 20}
    run = train(config("bc", **few), 0, out=tmp_path, server=server, say=quietly)
    (row,) = run.rows()
    assert row["success"] >= 0.7
    assert (row["steps"], row["updates"]) == (0, 3000)
    assert row["clone_loss"] < 0.05


def test_dagger_learns_what_demonstrations_did_not_show(tmp_path: Path, server: str) -> None:
    few = {"demos": 2, "clone_updates": 500, "hidden": [64, 64], "eval_episodes": 20}
    more = {"envs": 10, "epoch_episodes": 10, "epochs": 3}
    run = train(config("dagger", **few, **more), 0, out=tmp_path, server=server, say=quietly)
    rows = run.rows()
    assert rows[0]["success"] <= 0.3
    assert max(row["success"] for row in rows) >= 0.8
    assert [row["steps"] for row in rows] == [0, 500, 1000, 1500]


def test_td3_learns_from_hindsight_alone(tmp_path: Path, server: str) -> None:
    chosen = config("td3-her", learning_starts=500, enough=0.0)
    run = train(chosen, 0, out=tmp_path, server=server, say=quietly)
    rows = run.rows()
    assert rows[0]["success"] <= 0.2
    assert rows[-1]["success"] >= 0.9
    assert rows[-1]["steps"] == 500 + 3 * 20 * 50


def test_td3_learns_beyond_its_demonstrations(tmp_path: Path, server: str) -> None:
    few = {"demos": 3, "demo_batch": 32, "clone_updates": 200, "warm_up": 20}
    chosen = config("td3-demo", **few, noise=0.2, policy_weight=1.0, clone_weight=1.0)
    run = train(chosen, 0, out=tmp_path, server=server, say=quietly)
    rows = run.rows()
    assert rows[0]["success"] <= 0.4
    assert rows[-1]["success"] >= 0.8
    # No update of the policy while critics warm up, so nothing is told of one.
    assert "actor_loss" not in rows[1]
    assert "passed" in rows[2]


def test_training_ends_when_it_is_enough(tmp_path: Path, server: str) -> None:
    few = {"demos": 20, "clone_updates": 1000, "hidden": [64, 64], "eval_episodes": 10}
    chosen = config("dagger", **few, envs=5, epoch_episodes=5, epochs=50, enough=0.7)
    run = train(chosen, 0, out=tmp_path, server=server, say=quietly)
    worth = [row["success"] for row in run.rows()]
    assert len(worth) < 50
    assert worth[-1] >= 0.7 > max([0.0, *worth[:-1]])


def test_a_saved_policy_acts_by_itself(tmp_path: Path, server: str) -> None:
    few = {"demos": 3, "clone_updates": 50, "hidden": [16]}
    run = train(config("bc", "NeedlePick", **few), 0, out=tmp_path, server=server, say=quietly)
    policy = Run(run.path).policy()
    assert isinstance(policy, Policy)
    envs = make_vec("trocar/NeedlePick-v0", 5, server=server)
    one, other = (score(policy, envs, 3, 5), score(Policy.load(run.path / "last.zip"), envs, 3, 5))
    envs.close()
    assert one == other


def test_demonstrations_are_the_same_from_a_data_set(tmp_path: Path, server: str) -> None:
    chosen = config("bc", "GauzeRetrieve", demos=3, demo_noise=0.0)
    mine = expert(chosen, server)
    path = record("GauzeRetrieve-v0", episodes=3, seed=3_000_000, out=tmp_path, server=server).path
    theirs = recorded(Path(path), chosen, server)
    for name in mine.NAMES:
        assert np.array_equal(getattr(mine, name), getattr(theirs, name)), name


def test_every_step_of_demonstrations_is_labelled(raw: Td3Demo) -> None:
    assert raw.demos is not None
    features, actions = labelled(raw.demos, raw.features)
    assert features.shape == (100, FEATURES)
    assert actions.numpy() == pytest.approx(raw.demos.label.reshape(100, 1))
    assert features[50:, :9].numpy() == pytest.approx(raw.demos.observation[1, :50])


def test_disturbed_demonstrations_are_labelled_with_what_the_expert_wanted(server: str) -> None:
    calm, disturbed = (
        expert(config("bc", "GauzeRetrieve", demos=4, demo_noise=noise), server)
        for noise in (0.0, 0.05)
    )
    assert np.array_equal(calm.action, calm.label)
    off = disturbed.action - disturbed.label
    assert 0.01 < np.abs(off).mean() < 0.1
    # In the first state, which nothing has disturbed yet, it wants the same.
    assert np.array_equal(disturbed.label[:, 0], calm.label[: len(disturbed), 0])
    again = expert(config("bc", "GauzeRetrieve", demos=4, demo_noise=0.05), server)
    assert np.array_equal(again.action, disturbed.action)
