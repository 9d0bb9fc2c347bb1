"""Opens 16 environments, half for the scripted expert and half for random actions.

Prints how many of each ended in success.

    trocar serve --name lab &
    python random_policy.py lab
"""

import sys

import gymnasium as gym
import numpy as np

import trocar


def main() -> None:
    """Plays one episode in every environment."""
    server = sys.argv[1] if len(sys.argv) > 1 else None
    envs = gym.make_vec("trocar/NeedleReach-v0", num_envs=16, server=server, expert=True)
    assert isinstance(envs, trocar.TrocarVectorEnv)
    random = np.random.default_rng(1)
    _, infos = envs.reset(seed=0)
    while True:
        actions = infos["expert_action"]
        actions[8:] = random.uniform(-1, 1, actions[8:].shape)
        _, _, _, truncated, infos = envs.step(actions)
        if truncated[0]:
            expert, other = infos["is_success"][:8].sum(), infos["is_success"][8:].sum()
            print(f"expert: {expert} of 8, random: {other} of 8")
            break
    envs.close()


if __name__ == "__main__":
    main()
