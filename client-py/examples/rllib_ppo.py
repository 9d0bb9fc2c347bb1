"""PPO with RLlib on the dense reward of EcmReach: each env runner steps a session of its own.

With `vector_entry_point` RLlib takes Trocar's vector environment. It needs Gymnasium 1.2.2. The
runners are processes: `trocar:` before the id imports the package there, and all share the private
server of this program. On a cluster, start `trocar serve --name NAME` on each node and add
`"server": NAME` to `env_config`.

    pip install trocar[rllib]
    python rllib_ppo.py
"""

from __future__ import annotations

import argparse
import math

import ray
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.connectors.env_to_module import FlattenObservations, MeanStdFilter
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig

import trocar

RUNNERS = 2
ENVS = 16  # of a runner


def main() -> None:
    """Trains, and prints a line for every iteration."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--iterations", type=int, default=20)
    iterations = parser.parse_args().iterations

    ray.init(num_cpus=RUNNERS + 1, include_dashboard=False)
    config = (
        PPOConfig()
        .environment("trocar:trocar/EcmReach-v0", env_config={"reward": "dense"})
        .env_runners(
            num_env_runners=RUNNERS,
            num_envs_per_env_runner=ENVS,
            gym_env_vectorize_mode="vector_entry_point",
            rollout_fragment_length=50,
            env_to_module_connector=lambda *_, **__: [FlattenObservations(), MeanStdFilter()],
        )
        .training(train_batch_size=RUNNERS * ENVS * 50, minibatch_size=200, num_epochs=4, lr=1e-3)
        .rl_module(model_config=DefaultModelConfig(fcnet_hiddens=[64, 64]))
        .debugging(seed=0)
    )
    algorithm = config.build_algo()
    for iteration in range(1, iterations + 1):
        result = algorithm.train()["env_runners"]
        mean = result.get("episode_return_mean", math.nan)
        print(f"iteration {iteration:2}  mean return {mean:7.3f}", flush=True)
    for session in trocar.status()["sessions"]:
        print(f"a session of {session['envs']} environments of {session['task']}")
    algorithm.stop()
    ray.shutdown()


if __name__ == "__main__":
    main()
