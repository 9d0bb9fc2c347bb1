"""TorchRL over the environments of one session."""

from __future__ import annotations

import subprocess
import sys
from functools import partial
from pathlib import Path

import gymnasium as gym
import torch
from torchrl.collectors import Collector
from torchrl.envs import GymEnv, SerialEnv, check_env_specs

sys.path.append(str(Path(__file__).parents[2] / "examples"))

from torchrl_ppo import KEYS, make_env

TASK = "trocar/EcmReach-v0"
STEPS = 50


def test_what_torchrl_sees_is_what_gymnasium_sees(server: str) -> None:
    env = make_env(TASK, 3, seed=4, server=server)
    envs = gym.make_vec(TASK, 3, server=server, autoreset_mode="same_step", reward="dense")
    envs.reset(seed=4)
    observations, _ = envs.reset()  # TorchRL's seeding is a reset, too
    rollout = env.rollout(2 * STEPS + 10, break_when_any_done=False)
    for step in range(2 * STEPS + 10):
        at = rollout[:, step]
        assert all((at[key].numpy() == observations[key]).all() for key in KEYS)
        observations, rewards, _, truncations, infos = envs.step(at["action"].numpy())
        after = at["next"]
        assert (after["reward"].numpy()[:, 0] == rewards).all()
        assert (after["truncated"].numpy()[:, 0] == truncations).all()
        assert truncations.all() == (step % STEPS == STEPS - 1)
        assert (after["is_success"].numpy() == infos["is_success"]).all()
        for row in range(3):
            for key in KEYS:
                last = infos["final_obs"][row][key] if truncations[row] else observations[key][row]
                assert (after[key][row].numpy() == last).all()
    env.close()
    envs.close()


def test_specs_hold(server: str) -> None:
    env = make_env(TASK, 3, seed=0, server=server)
    assert env.batch_size == torch.Size([3])
    check_env_specs(env)
    state = env.rollout(STEPS)["state"]
    assert state.abs().max() <= 1
    assert state.std() > 0.1
    env.close()


def test_torchrls_own_classes_make_environments(server: str) -> None:
    """GymEnv tries a keyword that Trocar does not have, and goes on without it."""
    for task in (TASK, "trocar/ActiveTrack-v0"):
        env = GymEnv(task, server=server)
        assert env.rollout(7).batch_size == torch.Size([7])
        env.close()
    make = partial(GymEnv, TASK, server=server)
    several = SerialEnv(2, make)
    assert several.rollout(7).batch_size == torch.Size([2, 7])
    several.close()


def test_torchrls_processes_make_environments(server: str, tmp_path: Path) -> None:
    """In a program of its own, whose warnings are not errors."""
    program = tmp_path / "parallel.py"
    program.write_text(PARALLEL)
    done = subprocess.run(
        [sys.executable, program, f"trocar:{TASK}", server],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.stdout.split() == ["2", "7"], done.stderr


PARALLEL = """
import sys
from functools import partial
from torchrl.envs import GymEnv, ParallelEnv

if __name__ == "__main__":
    envs = ParallelEnv(2, partial(GymEnv, sys.argv[1], server=sys.argv[2]))
    print(*envs.rollout(7).batch_size)
    envs.close()
"""


def test_a_collector_goes_on_over_the_ends_of_episodes(server: str) -> None:
    env = make_env(TASK, 4, seed=0, server=server)
    collector = Collector(env, None, frames_per_batch=4 * 30, total_frames=4 * 120)
    batches = torch.cat(list(collector), dim=1)
    assert batches.batch_size == torch.Size([4, 120])
    ends = batches["next", "done"][0, :, 0].nonzero()[:, 0].tolist()
    assert ends == [STEPS - 1, 2 * STEPS - 1]
    following = batches["next", "observation"][:, :-1]
    unbroken = ~batches["next", "done"][:, :-1, 0]
    assert (following[unbroken] == batches["observation"][:, 1:][unbroken]).all()
    assert not (following[~unbroken] == batches["observation"][:, 1:][~unbroken]).all()
    collector.shutdown()
