"""Training: from demonstrations in minutes, and the paper's algorithms, on Trocar's tasks.

Needs the extra ``trocar[rl]``. From a shell:

    python -m trocar.rl train --task NeedlePick
    python -m trocar.rl evaluate runs/NeedlePick-v0/dagger/seed-0 --episodes 200
    python -m trocar.rl curves runs --out curves.png
    python -m trocar.rl export runs/NeedlePick-v0/dagger/seed-0 --out policy.onnx

Parts to build on: :func:`play` plays episodes in many environments, :class:`Episodes` keeps them
and draws transitions with hindsight goals, :class:`Inputs` is what networks see, and
:class:`Td3Demo`, :class:`Cloning` and :class:`Dagger` learn.
"""

try:
    import matplotlib  # noqa: F401
    import minari  # noqa: F401
    import onnx  # noqa: F401
    import stable_baselines3  # noqa: F401
    import tensorboard  # noqa: F401
except ImportError as error:
    from trocar._extras import missing_extra

    raise missing_extra(error, "rl", "training", command="trocar.rl") from error

from trocar.rl.algorithms import GoalDDPG, NormalisedDDPG, NormalisedPPO
from trocar.rl.config import ALGORITHMS, BEST, Config, load
from trocar.rl.episodes import Episodes, Transitions, play
from trocar.rl.evaluation import Score, score
from trocar.rl.export import export
from trocar.rl.features import BatchInputs, Inputs, Relative
from trocar.rl.imitation import Cloning, Dagger
from trocar.rl.learner import Learner
from trocar.rl.networks import Critics, Policy
from trocar.rl.runs import Run
from trocar.rl.td3 import Td3Demo
from trocar.rl.training import make_learner, train

__all__ = [
    "ALGORITHMS",
    "BEST",
    "BatchInputs",
    "Cloning",
    "Config",
    "Critics",
    "Dagger",
    "Episodes",
    "GoalDDPG",
    "Inputs",
    "Learner",
    "NormalisedDDPG",
    "NormalisedPPO",
    "Policy",
    "Relative",
    "Run",
    "Score",
    "Td3Demo",
    "Transitions",
    "export",
    "load",
    "make_learner",
    "play",
    "score",
    "train",
]
