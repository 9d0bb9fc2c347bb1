"""A task whose arms take the commands of a dVRK, for policies that people may correct."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar import _trocar
from trocar._arrays import floats
from trocar._connection import connect
from trocar._goal import (
    PICTURES,
    GoalFunctions,
    Observation,
    action_space,
    check_seed,
    observation_space,
    render_fps,
    view,
)
from trocar.dvrk._world import TICKS
from trocar.errors import (
    ArmIsDriven,
    InvalidAction,
    InvalidOption,
    ResetNeeded,
    SimulationError,
    TrocarError,
    refuse,
)

EVERY = 2
"""Ticks from one set-point to the next: 120 Hz."""

READY = 10.0
"""How long arms may take until they are homed, s of the world."""

Step = tuple[Observation, float, bool, bool, dict[str, Any]]
"""Observation, reward, terminated, truncated, info."""


class LiveEnv(GoalFunctions, gym.Env[Observation, NDArray[np.float32]]):
    """A task in a live world: actions become ``servo_cp`` and ``jaw/servo_jp`` at 120 Hz.

    Spaces, rewards and success are those of ``gym.make`` with the same task and options. An action
    leads to the same set-points, by smooth moves from rest to rest. Between steps no time passes in
    lock-step; at a speed it goes on, as it does for a robot.

    With ``intervention=True``, whoever has the page at :attr:`page` takes an arm over by key G, and
    gives it back by the same key. Actions for that arm are left out meanwhile. Infos then have:

    - ``is_intervention``: whether a person drove an arm in this step;
    - ``action``: the action that was carried out, float32 of the action's shape. Of what a person
      did it is the nearest action; it is what to learn from.

    Other keys are ``is_success`` and ``episode_seed``.

    Args:
        task: Id without namespace, e.g. ``NeedlePick-v0``.
        server: Name of the server; ``None`` for ``$TROCAR_SERVER``, else a private one.
        speed: How many times as fast as life; ``None`` for lock-step.
        intervention: Whether a page may take over. That needs a speed, and arms with instruments.
        max_steps: Steps of an episode; ``None`` for the task's number.
        render_mode: ``rgb_array``, ``depth_array`` or ``None``.
        render_options: How :meth:`render` draws, as :class:`trocar.TrocarEnv` has it.
        options: The task's options. Jaws hold by friction: ``grasp`` is ``"interact"``.

    Raises:
        ValueError: An argument or option is not allowed; the message says what is.
    """

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]
        "render_modes": ["rgb_array", "depth_array"],
        "render_fps": 5,
    }

    def __init__(
        self,
        task: str,
        *,
        server: str | None = None,
        speed: float | None = None,
        intervention: bool = False,
        max_steps: int | None = None,
        render_mode: str | None = None,
        render_options: Mapping[str, Any] | None = None,
        **options: Any,
    ) -> None:
        if intervention and speed is None:
            allowed = "a person needs time that passes: give a speed, 1.0 for real time"
            raise refuse(InvalidOption, "speed", None, allowed)
        if render_mode not in (None, *PICTURES):
            raise refuse(InvalidOption, "render_mode", render_mode, f"allowed are None, {PICTURES}")
        if max_steps is not None and max_steps < 1:
            raise refuse(InvalidOption, "max_steps", max_steps, "allowed are numbers from 1 on")
        self.render_mode = render_mode
        self._client = connect(server)
        self._live = self._client.open_live(
            task,
            options=options,
            homing="in_place",
            speed=speed,
            intervention=intervention,
            view=view(render_mode, render_options),
        )
        if self.task_spec.images is not None:
            self.close()
            allowed = "observations of a live world have no pictures; render_mode has them"
            raise refuse(InvalidOption, "options.observation", options.get("observation"), allowed)
        psms = [arm for arm in self._live.arms if arm != "ECM"]
        self._arms = psms or ["ECM"]
        if intervention and not psms:
            self.close()
            allowed = "a person takes over arms with instruments; this task moves the ECM"
            raise refuse(InvalidOption, "intervention", True, allowed)
        self._ticks = round(self.task_spec.seconds_per_step * TICKS)
        self.max_steps = max_steps or self.task_spec.max_steps
        """Steps after which an episode is truncated."""
        self._steps: int | None = None
        self._seed = 0
        self.metadata = {**type(self).metadata, "render_fps": render_fps(self.task_spec)}  # type: ignore[misc]
        self.action_space = action_space(self.task_spec)
        self.observation_space = observation_space(self.task_spec)

    @property
    def task_spec(self) -> _trocar.TaskSpec:  # type: ignore[override]
        """What the task looks like under the options of this environment."""
        return self._live.spec

    @property
    def live(self) -> _trocar.LiveWorld:
        """The live world."""
        return self._live

    @property
    def page(self) -> str:
        """Where the page is that may drive the arms: an address with a token."""
        return f"{self._client.driving_page()}&session={self._live.id}&env=0"

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begins the first episode of ``seed``, or of one that is drawn; homes the arms in place.

        A page that took arms over lets go of them.

        Args:
            seed: The seed of the episode.
            options: No option is allowed: a live world begins episodes as their seeds draw them.

        Raises:
            ValueError: An option is given. The message names the option; the episode goes on.
        """
        check_reset_options(options)
        super().reset(seed=seed)
        drawn = int(self.np_random.integers(2**63))
        self._seed = drawn if seed is None else check_seed(seed)
        self._live.reset(self._seed)
        for word in ("enable", "home"):
            for arm in self._arms:
                self._live.command(arm, "state_command", text=word)
        self._wait_until_homed()
        self._steps = 0
        return self._observation(), self._info(None, is_intervention=False)

    def step(self, action: ArrayLike | None) -> Step:
        """Acts for one step of the task's length; ``None`` holds the arms, unless a person drives.

        Raises:
            InvalidAction: The action has another shape, or numbers that are not finite.
            ResetNeeded: No episode goes on.
        """
        if self._steps is None:
            raise ResetNeeded("no episode goes on; reset the environment first")
        own = None if action is None else self._split(action)
        done, is_intervention = self._act(own)
        self._steps += 1
        world = self._live.world
        is_over = bool(world["terminated"])
        is_late = self._steps >= self.max_steps
        if is_over or is_late:
            self._steps = None
        info = self._info(done, is_intervention=is_intervention)
        return self._observation(), float(world["reward"]), is_over, is_late and not is_over, info

    def is_driven_by_person(self) -> bool:
        """Whether a page drives an arm now."""
        return any(self._is_taken(arm) for arm in self._arms)

    def wait_for_person(self) -> None:
        """Waits until a page drives an arm. The world's time passes, and no steps are counted."""
        while not self.is_driven_by_person():
            self._live.advance(self._ticks)

    def render(self) -> NDArray[Any] | None:
        """A picture of the present: uint8 (H, W, 3), or float32 (H, W) in m; else ``None``."""
        if self.render_mode is None:
            return None
        return self._live.render(depth=self.render_mode == "depth_array")

    def close(self) -> None:
        """Ends the session; twice does no harm."""
        self._live.close()

    # ---- Arms ----

    def _split(self, action: ArrayLike) -> list[list[float]]:
        """Each arm's numbers of an action."""
        array = floats(action, "action", "InvalidAction")
        expected = self.action_space.shape
        if array.shape != expected or not np.isfinite(array).all():
            allowed = f"expected finite numbers of shape {expected}"
            raise refuse(InvalidAction, "action", array.tolist(), allowed)
        limits = self.action_space
        clipped = np.clip(array, limits.low, limits.high)  # type: ignore[attr-defined]
        return [part.tolist() for part in np.split(clipped, len(self._arms))]

    def _act(self, own: list[list[float]] | None) -> tuple[NDArray[np.float32], bool]:
        """Lets a step pass: the action that was carried out, and whether a person drove."""
        starts = [self._set_point(arm) for arm in self._arms]
        goals = None
        if own is not None:
            goals = [
                self._ask(arm, "task/set_point", part)
                for arm, part in zip(self._arms, own, strict=True)
            ]
        taken = [False] * len(self._arms)
        for passed in range(EVERY, self._ticks + 1, EVERY):
            for index, arm in enumerate(self._arms):
                taken[index] |= self._is_taken(arm)
                if goals is not None and not taken[index]:
                    self._servo(arm, between(starts[index], goals[index], passed / self._ticks))
            self._advance(EVERY)
        done = []
        for index, arm in enumerate(self._arms):
            if own is not None and not taken[index]:
                done += own[index]
            elif arm == "ECM":
                done += [0.0] * len(self.task_spec.action)
            else:
                done += self._ask(arm, "task/action", starts[index], self._set_point(arm))
        return np.array(done, np.float32), any(taken)

    def _is_taken(self, arm: str) -> bool:
        _, driver, _ = self._live.status(arm)
        return driver not in (0, os.getpid())

    def _advance(self, ticks: int) -> None:
        try:
            self._live.advance(ticks)
        except ArmIsDriven:
            # A person took it over since it was looked at; what was commanded is left out.
            self._live.advance(ticks)

    def _ask(self, arm: str, question: str, numbers: Any, more: Any = ()) -> list[float]:
        answer, why = self._live.ask(arm, question, numbers, more)
        if why:
            raise TrocarError(f"{arm}, {question}: {why}")
        return answer

    def _set_point(self, arm: str) -> list[float]:
        """A PSM's pose and jaw angle, or the ECM's joints, as they were asked for."""
        if arm == "ECM":
            return self._live.joints(arm, setpoint=True)[0].tolist()  # type: ignore[no-any-return]
        pose, _ = self._live.pose(arm, "setpoint_cp")
        jaw, *_ = self._live.joints(arm, setpoint=True, jaw=True)
        return [*pose, float(jaw[0])]

    def _servo(self, arm: str, numbers: list[float]) -> None:
        if arm == "ECM":
            self._live.command(arm, "servo_jp", numbers)
            return
        self._live.command(arm, "servo_cp", numbers[:3], numbers[3:7])
        self._live.command(arm, "jaw/servo_jp", numbers[7:])

    def _wait_until_homed(self) -> None:
        left = round(READY * TICKS)
        states = [("", False, True)]
        while left > 0:
            left -= max(self._live.advance(min(left, EVERY)), 1)
            states = [self._live.operating_state(arm) for arm in self._arms]
            self._live.events()
            if all(state == ("ENABLED", True, False) for state in states):
                return
        raise SimulationError(f"arms are not ready after {READY} s: {states}")

    # ---- What is seen ----

    def _observation(self) -> Observation:
        self._live.events()
        observation, achieved, desired = self._live.observation()
        if not self.task_spec.has_goals:
            return observation
        return {
            "observation": observation,
            "achieved_goal": achieved,
            "desired_goal": desired,
        }

    def _info(self, action: NDArray[np.float32] | None, *, is_intervention: bool) -> dict[str, Any]:
        if action is None:
            action = np.zeros(self.action_space.shape or (), np.float32)
        return {
            "is_success": bool(self._live.world["is_success"]),
            "is_intervention": is_intervention,
            "action": action,
            "episode_seed": self._seed,
        }


def check_reset_options(options: Mapping[str, Any] | None) -> None:
    """Refuses all reset options, except those with the value ``None``.

    Raises:
        trocar.errors.InvalidOption: An option is given.
    """
    if options is not None and not isinstance(options, Mapping):
        raise refuse(InvalidOption, "options", options, "expected a dictionary")
    for name, value in (options or {}).items():
        if value is not None:
            allowed = "a live world has no reset options; gym.make's environment has"
            raise refuse(InvalidOption, f"options.{name}", value, allowed)


def between(start: list[float], end: list[float], part: float) -> list[float]:
    """The set-point after a part of a step, by a smooth move from rest to rest.

    Of eight numbers, four are a unit quaternion, which turns evenly about one axis; all others go
    straight.
    """
    share = part * part * (3.0 - 2.0 * part)
    first, last = np.array(start), np.array(end)
    numbers = first + share * (last - first)
    if len(start) == 8:
        one, other = first[3:7], last[3:7]
        cosine = float(one @ other)
        other, cosine = (other, cosine) if cosine >= 0.0 else (-other, -cosine)
        angle = np.arccos(min(cosine, 1.0))
        weights = np.array([1.0 - share, share])
        if angle > 1e-6:
            weights = np.sin(weights * angle) / np.sin(angle)
        turned = weights[0] * one + weights[1] * other
        numbers[3:7] = turned / np.linalg.norm(turned)
    return numbers.tolist()  # type: ignore[no-any-return]
