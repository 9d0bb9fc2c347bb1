"""The parts of trocar.rl alone: an expert is cloned, its clone plays, hindsight goals are drawn.

Needs the extra ``trocar[rl]``.
"""

from __future__ import annotations

import numpy as np
import torch

import trocar
from trocar.rl import Cloning, load, play
from trocar.rl.demonstrations import expert

torch.set_num_threads(1)  # networks this small need no more
with trocar.Server() as server:
    # Any field of a configuration may be another; `python -m trocar.rl configs` shows all of them.
    config = load("NeedleReach", "bc").but(demos=50, clone_updates=1500, envs=20, epoch_episodes=20)
    learner = Cloning(config, expert(config, server.name), seed=0, server=server.name)
    learner.begin(lambda _: None)
    policy = learner.policy

    # A function of what is seen acts in all environments at once.
    envs = trocar.TrocarVectorEnv(
        config.task, 20, server=server.name, autoreset_mode="disabled", expert=True
    )
    played = play(envs, lambda seen: policy.act(*seen.arrays), seeds=range(20))
    print(f"{played.succeeded.mean():.0%} of {len(played)} episodes succeed")
    off = np.abs(played.action - played.label).mean()
    print(f"its actions are {off:.3f} from those that the expert would have chosen")

    # Transitions as a critic learns from; most of them with goals that were reached later.
    drawn = played.sample(256, hindsight=0.8, goals=envs, random=np.random.default_rng(0))
    reached = drawn.reward == 0
    print(f"{reached.mean():.0%} of {len(reached)} transitions reach their goal")

    learner.close()
    envs.close()
