"""Trocar: Gymnasium environments of a surgical-robot simulation service.

Importing this package registers the ids ``trocar/<task>`` with Gymnasium. No server is needed for
that: the first environment connects to the server it names, to ``$TROCAR_SERVER``, or else to the
private server of this process tree, which is started and ended as needed.

>>> import gymnasium as gym, trocar
>>> env = gym.make("trocar/NeedleReach-v0")
>>> observation, info = env.reset(seed=0)
>>> sorted(observation)
['achieved_goal', 'desired_goal', 'observation']
>>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
>>> info["is_success"]
False
>>> env.close()
"""

from trocar import errors
from trocar._connection import status
from trocar._trocar import STAGES, Element, OptionSpec, TaskSpec, __version__
from trocar.env import TrocarEnv
from trocar.errors import Reconnected, ServerLost, TrocarError
from trocar.registration import register, register_all
from trocar.server import Server, binary
from trocar.snapshot import Snapshot
from trocar.vector import TrocarVectorEnv

__all__ = [
    "STAGES",
    "Element",
    "OptionSpec",
    "Reconnected",
    "Server",
    "ServerLost",
    "Snapshot",
    "TaskSpec",
    "TrocarEnv",
    "TrocarError",
    "TrocarVectorEnv",
    "__version__",
    "binary",
    "errors",
    "register",
    "register_all",
    "status",
]

register_all()
