"""One environment."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar import _trocar
from trocar._arrays import truth
from trocar._connection import Connection, Episodes
from trocar._goal import (
    PICTURES,
    RENDER_MODES,
    Described,
    GoalFunctions,
    Observation,
    action_space,
    check_seed,
    observation,
    observation_space,
    render_fps,
    shown,
    view,
    words,
)
from trocar._reset import ResetOptions
from trocar._window import Window
from trocar.errors import InvalidOption, ResetNeeded, refuse
from trocar.snapshot import Snapshot

Step = tuple[Observation, float, bool, bool, dict[str, Any]]
"""Observation, reward, terminated, truncated, info."""


class TrocarEnv(Described, GoalFunctions, gym.Env[Observation, NDArray[np.float32]]):
    """One environment of a task, simulated by a server.

    Observations are dictionaries of float32 arrays: ``observation``, ``achieved_goal`` and
    ``desired_goal``; :attr:`task_spec` says what each element means. ``info["is_success"]`` says
    after each step whether the goal is reached. Episodes never terminate there, unless
    ``terminate="success"``; they are truncated by the server at the task's number of steps, which
    ``spec.max_episode_steps`` has, too. Tasks without goals return the array
    ``observation`` alone, never report success, and may terminate.

    With the option ``observation``, e.g. ``("state", "rgb", "depth")``, pictures stand beside the
    goals: ``rgb`` uint8 (H, W, 3), ``depth`` float32 (H, W, 1) in m, ``mask`` int32 (H, W) and
    ``points`` float32 (H * W, 3) in m. ``image_size`` is (H, W), and ``camera`` is where they are
    taken from. With ``camera="stereo"`` they are ``rgb_left``, ``rgb_right`` and so on. With
    ``look="cavity"`` a lamp at the endoscope lights them, as in a body.
    Observations are then dictionaries for every task. ``task_spec.images`` has intrinsics and the
    names of the bodies in a mask.

    ``reset(seed=s)`` begins the first episode of seed ``s``, ``reset()`` the next one; which one it
    was, ``info["episode_seed"]`` and ``info["episode_index"]`` tell. Without any seed, a random one
    is drawn. Any non-negative integer is a seed; those from 2**63 on are mixed to one below it,
    which ``episode_seed`` then has and which begins the same episodes.

    Infos of resets and steps have the same keys: ``is_success``, ``simulation_failed``,
    ``episode_seed`` and ``episode_index``; ``tip_path``, the length (m) of the paths of the tips in
    the step, of all arms together; ``peak_force``, the largest force (N) between a jaw and a body
    in the step, averaged over 1/60 s; in tasks with soft bodies ``tissue_pressure`` (Pa),
    ``overstretched`` and ``crushed``; with ``expert=True`` also ``expert_action`` and
    ``expert_stage``.

    A copy, pickled or deep, has no session; its first ``reset`` opens one. So does a reset in a
    forked child process, and a reset after the server was lost. Without a seed, such a reset begins
    the episode that comes next, as the original's would. Until then steps raise
    :class:`~trocar.errors.ResetNeeded`, :class:`~trocar.errors.ForkedError` and
    :class:`~trocar.errors.ServerLost`.
    """

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]
        "render_modes": list(RENDER_MODES),
        "render_fps": 5,
    }

    def __init__(
        self,
        task: str,
        *,
        server: str | None = None,
        render_mode: str | None = None,
        render_options: Mapping[str, Any] | None = None,
        expert: bool = False,
        copy: bool = True,
        reconnect: bool | float = False,
        **options: Any,
    ) -> None:
        """Opens a session of one environment.

        Args:
            task: Task id without namespace, e.g. ``NeedleReach-v0``.
            server: Name of the server; ``None`` for ``$TROCAR_SERVER``, else a private one.
            render_mode: What :meth:`render` gives: ``rgb_array``, ``depth_array`` or ``None``; or
                ``human``, which opens the live viewer in a browser and steps no faster than
                life. Without a display it logs where the viewer is, and does not wait.
            render_options: How :meth:`render` draws: ``image_size`` (H, W; 480 by 640), ``camera``
                (``overview``, ``endoscope``, ``stereo`` with one picture above the other,
                ``placed``), and ``camera_eye``, ``camera_target``, ``camera_view`` of a placed one.
            expert: Whether ``info["expert_action"]`` shall hold the scripted expert's action, and
                ``info["expert_stage"]`` what it is about, by number in ``trocar.STAGES``.
            copy: With ``False``, observations are read-only views of shared memory, valid until
                the next step but one.
            reconnect: Whether to survive the loss of the server: for how many seconds another of
                its name is waited for (``True``: 60). Then :class:`~trocar.errors.Reconnected`
                says where the environment goes on; see :meth:`checkpoint`.
            options: The task's options; ``task_spec.options`` lists them.

        Raises:
            ValueError: An option is unknown or not allowed; the message lists what is.
        """
        wanted = view(render_mode, render_options)
        self.render_mode = render_mode
        self._copy = truth(copy, "copy")
        self._episode: tuple[int, int] | None = None
        self._window: Window | None = None
        self._expert_action: NDArray[np.float32] | None = None
        self._ends_on_success = options.get("terminate") == "success"
        self._has_relative_features = "relative" in words(options.get("observation"))
        self._connection = Connection(
            task,
            server=server,
            envs=1,
            autoreset="Disabled",
            expert=expert,
            options=options,
            view=wanted,
            reconnect=reconnect,
            shown=self._begun,
            latest=self._latest,
        )
        if render_mode == "human":
            self._window = Window(self.task_spec.seconds_per_step)
        fps = {"render_fps": render_fps(self.task_spec)}
        self.metadata = {**type(self).metadata, **fps}  # type: ignore[misc]
        self._reset_options = ResetOptions(self.task_spec, None)
        self.action_space = action_space(self.task_spec)
        self.observation_space = observation_space(self.task_spec)

    @property
    def task_spec(self) -> _trocar.TaskSpec:  # type: ignore[override]
        """What the task looks like under the options of this environment."""
        return self._connection.spec

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begins the first episode of ``seed``, or without one the next episode.

        Args:
            seed: Whose first episode begins: any non-negative integer.
            options: What shall be otherwise than the seed has it. Lengths are in m under every
                preset, in the scene frame. A pose is three numbers, its position, or six: then also
                roll, pitch and yaw (extrinsic XYZ Euler angles, rad). Names that are not listed
                here are ignored, with one warning.

                - ``goal``: the desired goal, a position.
                - ``objects``: poses by name, ``{"needle": pose}``, of the objects' own frames. Each
                  must rest where it is put; the settled state is where the episode begins.
                - ``tip``: where the tip of the closed jaws is; the angles are the wrist link's, as
                  observations show them. With two instruments, an array of two poses.

        Raises:
            ValueError: What ``options`` ask for cannot be; the message names it and says why. The
                episode has begun as its seed has it.
        """
        placements = self._reset_options.placements(options)
        seeds = None
        if seed is not None:
            seed = check_seed(seed)
            seeds = np.array([seed], np.uint64)
        super().reset(seed=seed)
        begun = self._begun(self._connection.reset(None, seeds))
        if placements:
            begun = self._begun(self._connection.arrange(None, placements))
        if self._window is not None:
            self._window.begin(self._connection)
        return begun

    def _begun(self, reply: _trocar.Reply) -> tuple[Observation, dict[str, Any]]:
        """Observation and info of an episode that begins, or goes on elsewhere."""
        observation, *_, info = self._transition(reply)
        return observation, info

    def _latest(self) -> Episodes | None:
        """Seed and number of the latest episode."""
        if self._episode is None:
            return None
        seed, episode = self._episode
        return np.array([seed], np.uint64), np.array([episode], np.uint64)

    def step(self, action: ArrayLike) -> Step:
        """Acts, and returns observation, reward, terminated, truncated, info."""
        transition = self._transition(self._connection.step(action, True))
        if self._window is not None:
            self._window.step()
        return transition

    def snapshot(self) -> Snapshot:
        """Saves the present state, at any moment after the first reset.

        Wrappers have state of their own: ``env.unwrapped`` has this method, and a ``TimeLimit``, if
        :func:`gymnasium.make` was told to add one, does not notice a :meth:`restore`.
        """
        return self._connection.snapshot()

    def checkpoint(self) -> None:
        """Saves the present state in this process: where ``reconnect`` goes on.

        The one before is forgotten.
        """
        self._connection.checkpoint()

    def restore(self, snapshot: Snapshot) -> Observation:
        """Goes on from a snapshot, and returns what is observed there.

        What then follows has the same bits as what followed the snapshot, seeds of later episodes
        included. It may be another environment's, of the same task and options.
        """
        return self._begun(self._connection.restore(snapshot))[0]

    def fork(self) -> TrocarEnv:
        """A second environment, with a session of its own, that goes on from the present state."""
        twin = deepcopy(self)
        twin.restore(self.snapshot())
        return twin

    def expert_action(self) -> NDArray[np.float32]:
        """What the scripted expert would do now; only with ``expert=True``."""
        if not self._connection.expert:
            raise refuse(InvalidOption, "expert", False, "make the environment with expert=True")
        if self._expert_action is None:
            raise ResetNeeded("the expert needs a state; reset the environment first")
        return np.array(self._expert_action)

    def render(self) -> NDArray[Any] | None:
        """A picture of the present state.

        Returns:
            With ``rgb_array`` uint8 (H, W, 3); with ``depth_array`` float32 (H, W), the depth along
            the optical axis in m; otherwise ``None``.
        """
        if self.render_mode not in PICTURES:
            return None
        return self._connection.render(0, self.render_mode)

    def close(self) -> None:
        """Ends the session; twice does no harm."""
        self._expert_action = None
        self._connection.close()

    def _transition(self, reply: _trocar.Reply) -> Step:
        """A reply as Gymnasium's five values."""
        expert = self._connection.expert
        reward, terminated, truncated, info = reply.outcome(expert)
        self._episode = info["episode_seed"], info["episode_index"]
        if expert:
            self._expert_action = info["expert_action"].copy()
        rows = observation(reply, self._copy).items()
        return shown({name: array[0] for name, array in rows}), reward, terminated, truncated, info

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_expert_action": None}
