"""RLlib over one session for each env runner."""

from __future__ import annotations

import gymnasium as gym
import pytest
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.connectors.env_to_module import FlattenObservations
from ray.rllib.env.single_agent_env_runner import SingleAgentEnvRunner

import trocar

TASK = "trocar/EcmReach-v0"
STEPS = 50

pytestmark = pytest.mark.filterwarnings("ignore")


def test_gymnasium_is_the_one_that_rllib_pins() -> None:
    assert gym.__version__ == "1.2.2"


def test_episodes_are_those_of_the_session(server: str) -> None:
    config = (
        PPOConfig()
        .environment(f"trocar:{TASK}", env_config={"reward": "dense", "server": server})
        .env_runners(
            num_env_runners=0,
            num_envs_per_env_runner=3,
            gym_env_vectorize_mode="vector_entry_point",
            env_to_module_connector=lambda *_, **__: FlattenObservations(),
        )
        .debugging(seed=7)
    )
    runner = SingleAgentEnvRunner(config=config)
    assert isinstance(runner.env.unwrapped, trocar.TrocarVectorEnv)
    assert runner.env.unwrapped.num_envs == 3
    episodes = runner.sample(num_episodes=6, random_actions=True)
    assert len(episodes) == 6
    single = gym.make(TASK, server=server, reward="dense")
    for episode in episodes:
        assert len(episode) == STEPS  # a step that only resets is none
        assert episode.is_truncated
        assert not episode.is_terminated
        # The same seed, episode and actions give the same bits in a single environment.
        info = episode.get_infos(0)
        observation, begun = single.reset(seed=int(info["episode_seed"]))
        while begun["episode_index"] < info["episode_index"]:
            observation, begun = single.reset()
        rewards = []
        for step, action in enumerate(episode.get_actions()):
            seen = episode.get_observations(step)
            assert (seen == gym.spaces.flatten(single.observation_space, observation)).all()
            observation, reward, *_ = single.step(action)
            rewards.append(reward)
        last = episode.get_observations(-1)
        assert (last == gym.spaces.flatten(single.observation_space, observation)).all()
        assert episode.get_rewards() == pytest.approx(rewards, abs=0)
        assert sum(rewards) < 0
    single.close()
    runner.stop()
