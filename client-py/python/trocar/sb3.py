"""Stable-Baselines3: the environments of one session as a ``VecEnv``.

>>> from trocar.sb3 import make_vec
>>> envs = make_vec("trocar/NeedleReach-v0", num_envs=8, seed=0)
>>> observations = envs.reset()
>>> goals = observations["achieved_goal"], observations["desired_goal"]
>>> envs.env_method("compute_reward", *goals, {}, indices=[0])[0].shape
(8,)
>>> envs.close()
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from trocar._arrays import selected
from trocar._extras import missing_extra
from trocar._goal import REPLACED_GOALS, GoalFunctions, words
from trocar.errors import InvalidEnvIds, InvalidOption, InvalidRequest, refuse
from trocar.registration import NAMESPACE
from trocar.vector import EPISODE, EXPERT, TrocarVectorEnv, nothing

try:
    from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvStepReturn
except ImportError as error:
    raise missing_extra(error, "sb3", "trocar.sb3") from error

from trocar._sb3_export import export

__all__ = ["METHODS", "TrocarVecEnv", "export", "make_vec"]

METHODS = tuple(name for name in vars(GoalFunctions) if name.startswith("compute_"))
"""What :meth:`TrocarVecEnv.env_method` answers: functions of goals, without asking the server."""


def make_vec(
    task: str, num_envs: int = 1, *, seed: int | None = None, **options: Any
) -> TrocarVecEnv:
    """Opens a session of ``num_envs`` environments for Stable-Baselines3.

    Args:
        task: Gymnasium id, e.g. ``trocar/NeedleReach-v0``.
        num_envs: How many environments.
        seed: ``s`` for first episodes of the seeds ``s, s + 1, …``; a random one if ``None``. An
            algorithm that is given a ``seed`` replaces it.
        options: ``server``, ``expert`` and the task's options, as for :func:`gymnasium.make_vec`.

    Raises:
        ValueError: An option is unknown or not allowed; the message lists what is.
    """
    if not task.startswith(f"{NAMESPACE}/"):
        raise refuse(InvalidOption, "task", task, f"allowed are the ids {NAMESPACE}/…")
    envs = gym.make_vec(task, num_envs, autoreset_mode=AutoresetMode.SAME_STEP, **options)
    assert isinstance(envs, TrocarVectorEnv)
    return TrocarVecEnv(envs, seed=seed)


class TrocarVecEnv(VecEnv):
    """N environments of a task in one session of a server, as Stable-Baselines3 has them.

    Between :meth:`step_async` and :meth:`step_wait` the server simulates. Info dicts hold what a
    single environment's do, ``TimeLimit.truncated`` and, where an episode ended,
    ``terminal_observation``; :attr:`reset_infos` tell which episodes began.

    For hindsight replay, ``compute_reward`` is answered in this process. Returns of episodes are
    recorded by Stable-Baselines3's ``VecMonitor``.
    """

    def __init__(self, envs: TrocarVectorEnv, *, seed: int | None = None) -> None:
        """Takes over environments with ``same_step`` autoreset; closing it closes them.

        Args:
            envs: The environments.
            seed: ``s`` for first episodes of the seeds ``s, s + 1, …``.

        Raises:
            ValueError: They have another autoreset mode.
        """
        if envs.autoreset_mode is not AutoresetMode.SAME_STEP:
            raise refuse(
                InvalidOption, "autoreset_mode", envs.autoreset_mode, "allowed is 'same_step'"
            )
        self.envs = envs
        zeros = nothing(envs.task_spec)
        self._nothing = {key: zero.item() for key, zero in zeros.items()}
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)
        if seed is not None:
            self.seed(seed)

    def reset(self) -> Any:
        """Begins new episodes, of the seeds set by :meth:`seed`; a step under way is dropped."""
        if any(self._options):
            raise refuse(InvalidOption, "options", self._options, "no reset options are known")
        observations, infos = self.envs.reset(seed=self._seeds)
        self._reset_seeds()
        self.reset_infos = self._told(infos)
        return observations

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Starts a step; ``actions`` has shape (num_envs, action dim).

        The reply to a step whose wait was interrupted, as by Ctrl-C, is dropped.
        """
        self.envs.drop_replies()
        self.envs.send(actions)

    def step_wait(self) -> VecEnvStepReturn:
        """Waits for the step, and returns observations, rewards, dones and an info dict for each.

        Where an episode ended, the observation is the first of the next one.
        """
        observations, rewards, terminations, truncations, infos = self.envs.recv()
        dones = terminations | truncations
        told = self._told(infos)
        for row in np.flatnonzero(dones).tolist():
            last = infos["final_info"]
            self.reset_infos[row] = {**told[row], **self._nothing}
            told[row] |= {name: last[name][row].item() for name in (*self._nothing, *EPISODE)}
            told[row]["terminal_observation"] = infos["final_obs"][row]
        for info, truncated in zip(told, (truncations & ~terminations).tolist(), strict=True):
            info["TimeLimit.truncated"] = truncated
        return observations, rewards, dones, told

    def env_method(
        self,
        method_name: str,
        *method_args: Any,
        indices: int | Iterable[int] | None = None,
        **method_kwargs: Any,
    ) -> list[Any]:
        """What a function of goals gives: the same for each environment, so it is called once.

        Raises:
            ValueError: The function is not one of :data:`METHODS`, or rewards of relabelled goals
                are requested while observations have relative features.
        """
        rows = self._rows(indices)
        if method_name == "render":
            images = self.get_images()
            return [images[row] for row in rows]
        if method_name == "compute_reward" and "relative" in self._observed():
            raise refuse(InvalidOption, "options.observation", self._observed(), REPLACED_GOALS)
        if method_name not in METHODS:
            allowed = f"allowed are {[*METHODS, 'render']}; the session as a whole is `envs`"
            raise refuse(InvalidRequest, "method_name", method_name, allowed)
        return [getattr(self.envs, method_name)(*method_args, **method_kwargs)] * len(rows)

    def get_attr(self, attr_name: str, indices: int | Iterable[int] | None = None) -> list[Any]:
        """An attribute of environments, as :meth:`TrocarVectorEnv.get_attr` returns it."""
        values = self.envs.get_attr(attr_name)
        return [values[row] for row in self._rows(indices)]

    def set_attr(
        self, attr_name: str, value: Any, indices: int | Iterable[int] | None = None
    ) -> None:
        """Sets an attribute of all environments, which they have in common.

        Raises:
            ValueError: ``indices`` are not all of them.
        """
        if set(self._rows(indices)) != set(range(self.num_envs)):
            allowed = "expected all, since the environments of a session share attributes"
            raise refuse(InvalidEnvIds, "indices", indices, allowed)
        self.envs.set_attr(attr_name, value)

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper], indices: int | Iterable[int] | None = None
    ) -> list[bool]:
        """Whether there is such a wrapper around single environments: never."""
        del wrapper_class
        return [False] * len(self._rows(indices))

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """A picture of each environment, where they were made with a render mode."""
        images = self.envs.render()
        return [None] * self.num_envs if images is None else list(images)

    def close(self) -> None:
        """Ends the session; twice does no harm."""
        self.envs.close()

    def _told(self, infos: dict[str, Any]) -> list[dict[str, Any]]:
        """Infos as a dictionary for each environment, with the values of a single one's."""
        keys = (*self._nothing, *EPISODE)
        rows = zip(*(infos[key].tolist() for key in keys), strict=True)
        told: list[dict[str, Any]] = [dict(zip(keys, row, strict=True)) for row in rows]
        if EXPERT[0] in infos:
            stages = infos["expert_stage"].tolist()
            for info, action, stage in zip(told, infos["expert_action"], stages, strict=True):
                info |= {"expert_action": action, "expert_stage": stage}
        return told

    def _observed(self) -> Sequence[str]:
        """Words of the task's option ``observation``."""
        return words(self.envs._connection._request["options"].get("observation"))

    def _rows(self, indices: int | Iterable[int] | None) -> list[int]:
        """The environments that ``indices`` mean."""
        if indices is None:
            return list(range(self.num_envs))
        if not hasattr(indices, "dtype") and isinstance(indices, Iterable):
            indices = list(indices)
        try:
            return selected(indices, self.num_envs)
        except (IndexError, InvalidRequest):
            allowed = f"allowed are numbers below {self.num_envs}"
            raise refuse(InvalidEnvIds, "indices", indices, allowed) from None
