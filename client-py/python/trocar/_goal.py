"""What environments and vector environments have in common: spaces, and functions of goals."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MethodType
from typing import Any, Concatenate, Generic, ParamSpec, TypeVar, cast

import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from numpy.typing import ArrayLike, NDArray

from trocar import _trocar
from trocar._arrays import described, integer
from trocar.errors import InvalidOption, InvalidRequest, refuse

Arrays = dict[str, NDArray[Any]]
"""Arrays by name: ``observation``, ``achieved_goal`` and ``desired_goal`` for tasks with goals, and
pictures where they are asked for."""

Observation = Any
"""What environments return: :data:`Arrays`, or the one array of a task without goals."""

REPLACED_GOALS = (
    "relative features contain the goal, which hindsight replay does not replace in observations; "
    "observe the state, and compute trocar.features in the policy, or train by trocar.rl with "
    "inputs=relative"
)
"""The remedy if goals of stored observations with relative features are replaced."""

_P = ParamSpec("_P")
_R = TypeVar("_R")


def words(option: Any) -> Sequence[str]:
    """The words of an option such as ``observation``: one word, several, or none."""
    return [option] if isinstance(option, str) else list(option or ())


class Described:
    """What Gymnasium's spec of an environment says: how many steps its episodes have.

    Gymnasium sets the spec when it makes an environment.
    """

    task_spec: _trocar.TaskSpec
    _spec: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """The spec that the environment was made from, if Gymnasium made it."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        if spec is not None:
            own, wanted = self.task_spec.max_steps, _wanted_steps(spec)
            if wanted is None:
                spec = replace(spec, max_episode_steps=own)
            elif not 1 <= wanted <= own:
                cast("Any", self).close()
                allowed = f"allowed are 1 to {own}; the option episode_seconds sets more"
                raise refuse(InvalidOption, "max_episode_steps", wanted, allowed)
        self._spec = spec


def _wanted_steps(spec: EnvSpec) -> int | None:
    """The time limit of an environment that Gymnasium makes.

    Gymnasium tells only its wrapper, which cannot make episodes longer than they are: what can be
    refused in time is in the call of ``gymnasium.make``.
    """
    maker = sys._getframe(2)
    wanted = spec.max_episode_steps
    if maker.f_globals.get("__name__") == "gymnasium.envs.registration":
        registered = getattr(maker.f_locals.get("env_spec"), "max_episode_steps", None)
        asked = maker.f_locals.get("max_episode_steps")
        wanted = registered if asked is None else asked
    return wanted


class _OfGoals(Generic[_P, _R]):
    """A method that only those environments have whose task has goals."""

    def __init__(self, function: Callable[Concatenate[Any, _P], _R]) -> None:
        self._function = function
        self.__doc__ = function.__doc__

    def __get__(self, env: Any, kind: type | None = None) -> Callable[_P, _R]:
        if env is None:
            return cast("Callable[_P, _R]", self)
        spec: _trocar.TaskSpec = env.task_spec
        name = self._function.__name__
        if not spec.has_goals or (name == "compute_reward" and spec.reward == "state"):
            raise AttributeError(f"{spec.id} has no {name}: it is no function of goals there")
        return cast("Callable[_P, _R]", MethodType(self._function, env))


class GoalFunctions:
    """Rewards as pure functions of goals, for one pair of goals or any batch of them.

    The functions are those that the server uses, so relabelled transitions (hindsight experience
    replay) get exactly the reward that the server would have given. Environments of a task without
    goals have no such attributes: ``hasattr(env.unwrapped, "compute_reward")`` is false.
    """

    task_spec: _trocar.TaskSpec
    _ends_on_success: bool = False
    _has_relative_features: bool = False
    """True for a single environment whose observations contain the goal. There, only hindsight
    replay asks for the rewards of batches."""

    @_OfGoals
    def compute_reward(
        self, achieved_goal: ArrayLike, desired_goal: ArrayLike, info: Any = None
    ) -> Any:
        """Rewards of goals of shape (..., goal dim): float32 of shape (...).

        Args:
            achieved_goal: Goals that were achieved.
            desired_goal: Goals that were desired, of the same shape.
            info: Not used; there for the interface that hindsight replay expects.

        Raises:
            ValueError: A batch, of a single environment with ``observation=("relative",)``.
        """
        del info
        if self._has_relative_features and np.ndim(achieved_goal) > 1:
            raise refuse(InvalidOption, "options.observation", "relative", REPLACED_GOALS)
        return self.task_spec.compute_reward(achieved_goal, desired_goal)[()]

    @_OfGoals
    def compute_terminated(
        self, achieved_goal: ArrayLike, desired_goal: ArrayLike, info: Any = None
    ) -> Any:
        """Whether episodes end at these goals; bool of shape (...).

        They never do, but with ``terminate="success"`` where the goals are reached.
        """
        del info
        success = self.task_spec.compute_success(achieved_goal, desired_goal)
        return (success if self._ends_on_success else np.zeros_like(success))[()]

    @_OfGoals
    def compute_truncated(
        self, achieved_goal: ArrayLike, desired_goal: ArrayLike, info: Any = None
    ) -> Any:
        """Whether episodes are cut short at these goals: never, that is up to the time limit."""
        del info
        return np.zeros_like(self.task_spec.compute_success(achieved_goal, desired_goal))[()]

    @_OfGoals
    def compute_success(self, achieved_goal: ArrayLike, desired_goal: ArrayLike) -> Any:
        """Whether goals of shape (..., goal dim) are reached: bool of shape (...)."""
        return self.task_spec.compute_success(achieved_goal, desired_goal)[()]


def action_space(spec: _trocar.TaskSpec) -> spaces.Space[NDArray[np.float32]]:
    """The actions of one environment."""
    return _box(spec.action)


def observation_space(spec: _trocar.TaskSpec) -> spaces.Space[Observation]:
    """The observations of one environment."""
    state = _box(spec.observation)
    if spec.goal is None and spec.images is None:
        return state
    parts: dict[str, spaces.Space[Any]] = {}
    if spec.images is None or spec.images.with_state:
        parts["observation"] = state
    if spec.goal is not None:
        parts["achieved_goal"] = parts["desired_goal"] = _box(spec.goal)
    if spec.images is not None:
        parts |= _image_spaces(spec.images)
    return spaces.Dict(parts)


def _image_spaces(images: _trocar.ImageSpec) -> dict[str, spaces.Space[Any]]:
    """The pictures of an observation, by name."""
    height, width = images.height, images.width
    across, down = images.reach
    far = np.array([across, down, images.far], np.float32)
    near = np.array([-across, -down, 0.0], np.float32)
    shape = (height * width, 3)
    points = np.broadcast_to(near, shape), np.broadcast_to(far, shape)
    boxes: dict[str, spaces.Space[Any]] = {
        "rgb": spaces.Box(0, 255, (height, width, 3), np.uint8),
        "depth": spaces.Box(0.0, images.far, (height, width, 1), np.float32),
        "mask": spaces.Box(0, len(images.bodies), (height, width), np.int32),
        "points": spaces.Box(*points, dtype=np.float32),
    }
    names = [(kind, view) for kind in images.kinds for view in images.views]
    return {kind + view: boxes[kind] for kind, view in names}


def _box(elements: Sequence[_trocar.Element]) -> spaces.Space[NDArray[np.float32]]:
    low, high = ([getattr(element, end) for element in elements] for end in ("min", "max"))
    box = spaces.Box(np.array(low, np.float32), np.array(high, np.float32), dtype=np.float32)
    # Nor, before 1.4, which dtype a Box has.
    return cast("spaces.Space[NDArray[np.float32]]", box)


def observation(reply: _trocar.Reply, copy: bool) -> Arrays:
    """What a reply shows: arrays of shape (rows, ...)."""
    arrays: Arrays = reply.images(copy)
    if reply.has_state:
        arrays["observation"] = reply.array("observation", copy)
    if reply.has_goals:
        arrays["achieved_goal"] = reply.array("achieved_goal", copy)
        arrays["desired_goal"] = reply.array("desired_goal", copy)
    return arrays


def final_observation(reply: _trocar.Reply) -> Arrays:
    """The last of episodes that the same step replaced: arrays of shape (rows, ...)."""
    arrays: Arrays = reply.final_images()
    if reply.has_state:
        arrays["observation"] = reply.array("final_observation")
    if reply.has_goals:
        arrays["achieved_goal"] = reply.array("final_achieved_goal")
        arrays["desired_goal"] = reply.array("final_desired_goal")
    return arrays


def shown(arrays: Arrays) -> Observation:
    """What an environment returns: all arrays by name, or the state where there is nothing else."""
    return arrays["observation"] if arrays.keys() == {"observation"} else arrays


def check_seed(seed: Any, field: str = "seed") -> int:
    """The seed of a number, which may be any non-negative integer."""
    number = integer(seed, field, InvalidRequest, "a non-negative integer")
    if number < 0:
        raise refuse(InvalidRequest, field, seed, "expected a non-negative integer")
    return _trocar.seed_of(number.to_bytes(number.bit_length() // 8 + 1, "little"))


PICTURES = ("rgb_array", "depth_array")
"""Render modes that give pictures."""

RENDER_MODES = ("human", *PICTURES)
"""What ``render_mode`` may be, besides ``None``."""


def view(mode: str | None, options: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """How a session is to draw its environments; ``None`` where it need not."""
    if mode is not None and mode not in RENDER_MODES:
        allowed = f"allowed are None, {', '.join(map(repr, RENDER_MODES))}"
        raise refuse(UnknownRenderMode, "render_mode", mode, allowed)
    if options is not None and not isinstance(options, Mapping):
        allowed = "expected a dictionary"
        raise refuse(InvalidOption, "render_options", options, allowed, described(options))
    if mode in PICTURES:
        return dict(options or {})
    if options:
        allowed = f"they need render_mode {' or '.join(map(repr, PICTURES))}"
        raise refuse(InvalidOption, "render_options", dict(options), allowed)
    return None


def render_fps(spec: _trocar.TaskSpec) -> int:
    """Pictures a second at which a recording runs as fast as the simulated time."""
    return max(1, round(1.0 / spec.seconds_per_step))


class UnknownRenderMode(InvalidOption, TypeError):
    """A TypeError too: that is what makes Stable-Baselines3's ``make_vec_env`` do without."""
