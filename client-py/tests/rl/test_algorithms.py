"""Normalisation, relabelling, losses and the Q-filter on cases with known answers."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from gymnasium import spaces
from onnx.reference import ReferenceEvaluator
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.type_aliases import DictReplayBufferSamples

from trocar.demos import record
from trocar.rl import GoalDDPG, export, load
from trocar.rl.baselines import make_model
from trocar.rl.config import Config
from trocar.rl.demonstrations import buffer, recorded
from trocar.rl.features import Inputs
from trocar.rl.normalise import Normalised
from trocar.sb3 import TrocarVecEnv, make_vec

# One action, one goal: what networks compute can be written down.
TASK = "MisOrient-v0"
DEMOS = 4


@pytest.fixture
def envs(server: str) -> Iterator[TrocarVecEnv]:
    """Two environments."""
    made = make_vec(f"trocar/{TASK}", 2, server=server)
    yield made
    made.close()


def config(**changes: Any) -> Config:
    small = {"hidden": [2], "epochs": 1, "epoch_episodes": 4, "batch_size": 64, "updates": 3}
    return load(TASK, "her-demo").but(**(small | {"demos": DEMOS, "demo_batch": 16} | changes))


@pytest.fixture
def model(envs: TrocarVecEnv) -> GoalDDPG:
    return made(envs)


def made(envs: TrocarVecEnv, **changes: Any) -> GoalDDPG:
    model = make_model(config(**changes), envs, 0)
    assert isinstance(model, GoalDDPG)
    model.set_logger(Logger(None, []))
    return model


def set_layers(network: torch.nn.Module, *layers: tuple[list[Any], list[float]]) -> None:
    """Gives a network these weights and biases, layer by layer."""
    linear = [part for part in network.modules() if isinstance(part, torch.nn.Linear)]
    with torch.no_grad():
        for layer, (weights, biases) in zip(linear, layers, strict=True):
            wanted = torch.zeros_like(layer.weight)
            rows = torch.tensor(weights)
            wanted[:, -rows.shape[1] :] = rows
            layer.weight.copy_(wanted)
            layer.bias.copy_(torch.tensor(biases))


def rate_by_action(model: GoalDDPG) -> None:
    """A critic that gives the action itself as its value: relu(a) - relu(-a)."""
    for critic in (model.critic, model.critic_target):
        set_layers(critic, ([[1.0], [-1.0]], [0.0, 0.0]), ([[1.0, -1.0]], [0.0]))


def act_always(model: GoalDDPG, action: float) -> None:
    """An actor that does the same in every state."""
    for actor in (model.actor, model.actor_target):
        bias = float(np.arctanh(action))
        set_layers(actor, ([[0.0], [0.0]], [0.0, 0.0]), ([[0.0, 0.0]], [bias]))


def batch(
    actions: list[float], rewards: list[float], dones: list[float]
) -> DictReplayBufferSamples:
    rows = len(actions)
    seen = {
        "observation": torch.zeros(rows, 9),
        "achieved_goal": torch.zeros(rows, 1),
        "desired_goal": torch.zeros(rows, 1),
    }
    columns = [torch.tensor(values)[:, None] for values in (actions, rewards, dones)]
    return DictReplayBufferSamples(seen, columns[0], seen, columns[2], columns[1])


def test_inputs_are_relative_to_what_was_seen() -> None:
    bound = np.array([2.0, 4.0], np.float32)
    space = spaces.Dict(
        {
            name: spaces.Box(-bound, bound)
            for name in ("observation", "achieved_goal", "desired_goal")
        }
    )
    sizes = {"observation": 2, "achieved_goal": 2, "desired_goal": 2, "contact": 0}
    inputs = Inputs(("observation", "desired_goal"), sizes, [])
    extractor = Normalised(space, inputs=inputs, eps=0.5, clip=3.0)
    zeros = {name: torch.zeros(1, 2) for name in space}
    # Nothing was seen: bounds are two standard deviations.
    extractor.refresh()
    assert extractor(zeros | {"observation": torch.tensor([[1.0, 2.0]])})[0, :2].tolist() == [1, 1]
    rows = np.array([[1.0, 0.1], [3.0, 0.1]], np.float32)
    extractor.see(
        {"observation": rows, "achieved_goal": rows * 0 + 5, "desired_goal": rows * 0 + 1}
    )
    assert extractor.running_mean.tolist() == [0, 0, 0, 0]
    extractor.refresh()
    # Both goals count, and a standard deviation is at least eps.
    assert extractor.running_mean.tolist() == pytest.approx([2, 0.1, 3, 3])
    assert extractor.running_std.tolist() == pytest.approx([1, 0.5, 2, 2])
    features = extractor(zeros | {"observation": torch.tensor([[2.5, 9.0]])})
    assert features[0].tolist() == pytest.approx([0.5, 3.0, -1.5, -1.5])


def test_targets_are_returns_that_are_possible(model: GoalDDPG) -> None:
    model.gamma = 0.5  # so that no return is below -2
    rate_by_action(model)
    act_always(model, 0.8)
    cases = batch([0.0, 0.0, 0.0], [-1.0, -1.0, 0.0], [0.0, 1.0, 0.0])
    # -1 + 0.5 · 0.8; the end of an episode; 0.4 is above what is possible.
    assert model.critic_loss(cases).item() == pytest.approx((0.6**2 + 1 + 0) / 3, rel=1e-5)
    set_layers(model.critic_target, ([[0.0], [0.0]], [0.0, 0.0]), ([[0.0, 0.0]], [-50.0]))
    assert model.critic_loss(cases).item() == pytest.approx((4 + 1 + 4) / 3, rel=1e-5)


def test_only_demonstrated_actions_that_are_rated_higher_are_cloned(envs: TrocarVecEnv) -> None:
    shown = [0.5, 0.9, 0.2, -0.7]
    own = [0.1] * 60
    cases = batch(own + shown, [-1.0] * 64, [0.0] * 64)
    for q_filter, passing in ((True, shown[:2]), (False, shown)):
        model = made(envs, demo_batch=4, q_filter=q_filter, action_l2=0.0)
        rate_by_action(model)
        act_always(model, 0.3)
        model.demos = model.replay_buffer  # type: ignore[assignment]
        losses = model.actor_losses(cases)
        clone = sum((0.3 - action) ** 2 for action in passing)
        assert losses.clone.item() == pytest.approx(clone, rel=1e-4)
        assert losses.passed.item() == pytest.approx(len(passing) / 4)
        expected = 0.001 * -0.3 + 0.0078 * clone
        assert losses.policy.item() == pytest.approx(expected, rel=1e-4)
    # A critic that rates everything the same passes nothing.
    model = made(envs, demo_batch=4)
    act_always(model, 0.3)
    set_layers(model.critic, ([[0.0], [0.0]], [0.0, 0.0]), ([[0.0, 0.0]], [-3.0]))
    model.demos = model.replay_buffer  # type: ignore[assignment]
    assert model.actor_losses(cases).passed.item() == 0


def test_large_actions_cost(envs: TrocarVecEnv) -> None:
    model = made(envs, action_l2=2.0)
    rate_by_action(model)
    act_always(model, 0.5)
    losses = model.actor_losses(batch([0.0] * 8, [0.0] * 8, [0.0] * 8))
    assert losses.policy.item() == pytest.approx(-0.5 + 2.0 * 0.25, abs=1e-5)
    assert losses.clone.item() == 0


@pytest.fixture(scope="module")
def dataset(server: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A few demonstrations."""
    out = tmp_path_factory.mktemp("demos")
    return Path(record(TASK, episodes=DEMOS, out=out, server=server).path)


def test_demonstrations_are_relabelled_like_experience(
    envs: TrocarVecEnv, dataset: Path, server: str
) -> None:
    demos = buffer(recorded(dataset, config(), server), config(), envs)
    assert demos.size() == 50 * DEMOS
    drawn = demos.sample(2000)
    achieved, desired, given = (
        demos.next_observations[name][:, 0, 0]
        for name in ("achieved_goal", "desired_goal", "desired_goal")
    )
    seen = demos.observations["observation"][:, 0]
    relabelled = 0
    for row in range(2000):
        now = drawn.observations["observation"][row].numpy()
        (index,) = np.flatnonzero((seen == now).all(axis=1))[:1]
        end = (index // 50 + 1) * 50
        goal = drawn.observations["desired_goal"][row].item()
        assert goal == drawn.next_observations["desired_goal"][row].item()
        if goal != given[index]:
            relabelled += 1
            assert goal in achieved[index:end]
    # Four of five goals were reached later; a few of those are the given one.
    assert 0.7 < relabelled / 2000 < 0.81
    reached = drawn.next_observations["achieved_goal"].numpy()
    wanted = drawn.next_observations["desired_goal"].numpy()
    assert (drawn.rewards.numpy()[:, 0] == envs.envs.compute_reward(reached, wanted)).all()
    assert set(np.unique(drawn.rewards.numpy())) == {-1.0, 0.0}
    assert desired.shape == achieved.shape
    # The end of an episode is its time limit, beyond which values go on.
    assert drawn.dones.sum() == 0


def test_a_batch_ends_with_demonstrations(envs: TrocarVecEnv, dataset: Path, server: str) -> None:
    model = made(envs, noise=0.0, random_actions=1.0)
    model.learn_from(buffer(recorded(dataset, config(), server), config(), envs))
    model.learn(100)
    drawn = model.sample(64)
    assert model.demos is not None
    shown = set(model.demos.actions[:, 0, 0].tolist())
    own = set(model.replay_buffer.actions[:50].ravel().tolist())  # type: ignore[union-attr]
    assert all(action in own for action in drawn.actions[:48, 0].tolist())
    assert all(action in shown for action in drawn.actions[48:, 0].tolist())
    assert drawn.rewards.shape == (64, 1)


def test_exploring_is_random_as_much_as_it_shall_be(envs: TrocarVecEnv) -> None:
    model = made(envs, noise=0.0, random_actions=0.0)
    act_always(model, 0.25)
    model.learn(100)
    assert model.replay_buffer is not None
    first = model.replay_buffer.actions[:50].ravel()
    assert np.allclose(first, 0.25, atol=1e-6)
    model = made(envs, noise=0.0, random_actions=0.3)
    act_always(model, 0.25)
    with torch.no_grad():  # so that training changes nothing
        model.actor.optimizer.param_groups[0]["lr"] = 0.0
    actions = np.concatenate(
        [model._sample_action(0, None, 2)[1].ravel() for _ in range(500) if _seen(model, envs)]
    )
    random = np.abs(actions - 0.25) > 1e-6
    assert 0.25 < random.mean() < 0.35
    assert np.abs(actions[random].mean()) < 0.1


@pytest.mark.parametrize("averaged", [False, True])
def test_the_target_actor_acts_where_that_is_asked_for(
    envs: TrocarVecEnv, averaged: bool, tmp_path: Path
) -> None:
    model = made(envs, noise=0.0, random_actions=0.0, averaged=averaged)
    act_always(model, 0.25)
    set_layers(model.actor_target, ([[0.0], [0.0]], [0.0, 0.0]), ([[0.0, 0.0]], [-0.5]))
    expected = float(np.tanh(-0.5)) if averaged else 0.25
    observations: Any = envs.reset()
    actions, _ = model.predict(observations, deterministic=True)
    assert np.allclose(actions, expected, atol=1e-6)
    path = export(model, config(averaged=averaged), tmp_path / "policy.onnx")
    network = ReferenceEvaluator(str(path))
    inputs = {name: observations[name][:1] for name in network.input_names}
    (action,) = network.run(None, inputs)
    assert np.allclose(action, expected, atol=1e-6)
    model.learn(100)
    assert model.replay_buffer is not None
    assert np.allclose(model.replay_buffer.actions[:50], expected, atol=1e-6)


def _seen(model: GoalDDPG, envs: TrocarVecEnv) -> bool:
    """Gives the model something to look at."""
    if model._last_obs is None:
        model._last_obs = envs.reset()
    return True


def test_targets_follow_once_in_a_training(envs: TrocarVecEnv) -> None:
    model = made(envs, tau=0.25)
    before = [weights.clone() for weights in model.critic_target.parameters()]
    model.learn(100)  # one episode of each environment, then one training of three updates
    assert model._n_updates == 3
    now = list(model.critic.parameters())
    for old, weights, target in zip(before, now, model.critic_target.parameters(), strict=True):
        assert torch.allclose(target, 0.75 * old + 0.25 * weights, atol=1e-6)
    mean = model.normalised.running_mean
    followed = model.actor_target.features_extractor
    assert isinstance(followed, Normalised)
    assert torch.equal(followed.running_mean, mean)
    assert (mean != 0).any()
