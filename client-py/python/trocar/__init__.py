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

**Arrays.** Wherever a function takes an array, it takes what :func:`numpy.asarray` makes one of:
arrays of any strides, alignment and byte order, packed records' fields, lists, and tensors of other
libraries in the memory of the CPU. Values and shape count, and the layout does not:

- *Numbers* (actions, goals, positions in reset options) are truth values, integers or floating
  point, of any width. Actions and goals are rounded to the nearest float32, positions to float64.
  An action has the shape of its space, two goals one shape (..., goal dim). Nothing is broadcast.
- *Integers* (environments, seeds, states of a snapshot) are signed or unsigned, of any width.
- *Truth values* (masks) are bool, and nothing else. Flags such as ``expert`` are ``True`` or
  ``False``, Python's or NumPy's.
- *Bytes* (exported snapshots) are bytes, or one row of elements of one byte each.

All else is refused by a ``ValueError`` that names the argument, its shape and type, and what was
expected: complex numbers, text, objects, rows of different lengths, masked values, tensors that
their library does not hand over. A row-major, aligned array of float32 is not copied.
"""

from trocar import errors
from trocar._connection import connect, status
from trocar._features import features
from trocar._trocar import STAGES, Element, GoalPart, OptionSpec, TaskSpec, __version__
from trocar.env import TrocarEnv
from trocar.errors import Reconnected, ServerLost, TrocarError
from trocar.registration import register, register_all
from trocar.server import Server, binary
from trocar.snapshot import Snapshot
from trocar.vector import TrocarVectorEnv

__all__ = [
    "STAGES",
    "Element",
    "GoalPart",
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
    "connect",
    "errors",
    "features",
    "register",
    "register_all",
    "status",
]

register_all()
