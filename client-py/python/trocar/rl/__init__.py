"""Training: DDPG, hindsight replay, demonstrations and PPO on Trocar's tasks.

Needs the extra ``trocar[rl]``. From a shell:

    python -m trocar.rl train --task NeedlePick --algo her-demo --seed 1
    python -m trocar.rl evaluate runs/NeedlePick-v0/her-demo/seed-1 --episodes 200
    python -m trocar.rl curves runs --out curves.png
    python -m trocar.rl export runs/NeedlePick-v0/her-demo/seed-1 --out policy.onnx
"""

try:
    import matplotlib  # noqa: F401
    import minari  # noqa: F401
    import stable_baselines3  # noqa: F401
    import tensorboard  # noqa: F401
except ImportError as error:
    raise ModuleNotFoundError(
        f"{error}; training needs the extra: pip install trocar[rl]"
    ) from error

from trocar.rl.algorithms import GoalDDPG, NormalisedDDPG, NormalisedPPO
from trocar.rl.config import ALGORITHMS, Config, load
from trocar.rl.evaluation import Score, score
from trocar.rl.export import export
from trocar.rl.runs import Run
from trocar.rl.training import train

__all__ = [
    "ALGORITHMS",
    "Config",
    "GoalDDPG",
    "NormalisedDDPG",
    "NormalisedPPO",
    "Run",
    "Score",
    "export",
    "load",
    "score",
    "train",
]
