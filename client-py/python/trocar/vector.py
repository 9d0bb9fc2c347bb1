"""Many environments of one task in one session, stepped by one message."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from trocar import _trocar
from trocar._arrays import integer, integers, is_single, refused, truth, truths
from trocar._attributes import Attributes
from trocar._connection import Connection, Episodes
from trocar._goal import (
    PICTURES,
    RENDER_MODES,
    Described,
    GoalFunctions,
    Observation,
    action_space,
    check_seed,
    final_observation,
    observation,
    observation_space,
    render_fps,
    shown,
    view,
)
from trocar._reset import ResetOptions
from trocar._window import Window
from trocar.errors import (
    InvalidEnvCount,
    InvalidEnvIds,
    InvalidOption,
    InvalidRequest,
    ResetNeeded,
    refuse,
)
from trocar.snapshot import Snapshot

Step = tuple[Observation, NDArray[np.float32], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]
"""Observations, rewards, terminations, truncations, infos; a row for each environment."""


def _keys(*roles: str) -> tuple[str, ...]:
    """The keys of infos of these roles."""
    return tuple(key for role, key, _, _ in _trocar.INFOS if role in roles)


EPISODE = _keys("episode")
"""Infos that say which episode began; ``episode`` alone is what Gymnasium's recorders use."""

OUTCOME = _keys("step", "fault")
"""Infos of every task's transitions; see :func:`nothing`."""

TISSUE = _keys("tissue")
"""Infos of transitions of tasks with soft bodies."""

EXPERT = _keys("expert")
"""Infos of the scripted expert, where it is asked for."""


def nothing(spec: _trocar.TaskSpec) -> dict[str, NDArray[Any]]:
    """What infos of a task's transitions are where a reset made none: false, or 0."""
    keys = OUTCOME + TISSUE if spec.has_tissue else OUTCOME
    return {key: np.zeros((), dtype) for _, key, _, dtype in _trocar.INFOS if key in keys}


class TrocarVectorEnv(
    Attributes,
    Described,
    GoalFunctions,
    gym.vector.VectorEnv[Observation, NDArray[np.float32], NDArray[Any]],
):
    """N environments of a task in one session of a server, stepped by one message.

    What is said of :class:`~trocar.TrocarEnv` holds for each of them. Infos are Gymnasium's: an
    array per key, and under ``_key`` where it applies. ``is_success`` tells of every transition,
    also where ``same_step`` autoreset began a new episode, which ``episode_seed`` and
    ``episode_index`` then tell of. Where an episode ended, ``same_step`` adds ``final_obs`` and
    ``final_info``.

    Instead of :meth:`step`, up to two disjoint groups of environments may be under way by
    :meth:`send` and :meth:`recv`: while one is simulated, the other's actions can be computed.
    """

    def __init__(
        self,
        task: str,
        num_envs: int = 1,
        *,
        server: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        render_options: Mapping[str, Any] | None = None,
        max_episode_steps: int | None = None,
        expert: bool = False,
        copy: bool = True,
        reconnect: bool | float = False,
        **options: Any,
    ) -> None:
        """Opens a session of ``num_envs`` environments.

        Args:
            task: Task id without namespace, e.g. ``NeedleReach-v0``.
            num_envs: How many environments.
            server: Name of the server; ``None`` for ``$TROCAR_SERVER``, else a private one.
            autoreset_mode: What happens to an environment whose episode ended: ``next_step``
                (the next step resets it and ignores its action), ``same_step`` (the same step
                resets it) or ``disabled`` (``reset`` with a ``reset_mask`` must).
            render_mode: What :meth:`render` gives: ``rgb_array``, ``depth_array`` or ``None``; or
                ``human``, which opens the live viewer in a browser, where there is a display.
            render_options: How :meth:`render` draws: ``image_size`` (H, W; 480 by 640), ``camera``
                (``overview``, ``endoscope``, ``stereo`` with one picture above the other,
                ``placed``), and ``camera_eye``, ``camera_target``, ``camera_view`` of a placed one.
            max_episode_steps: The task's own number or ``None``; Gymnasium's wrapper of single
                environments can make it less.
            expert: Whether ``infos["expert_action"]`` shall hold the scripted expert's actions, and
                ``infos["expert_stage"]`` what it is about, by number in ``trocar.STAGES``.
            copy: With ``False``, observations are read-only views of shared memory, valid until
                the next step but one.
            reconnect: Whether to survive the loss of the server: for how many seconds another of
                its name is waited for (``True``: 60). Then :class:`~trocar.errors.Reconnected`
                says where all environments go on; see :meth:`checkpoint`.
            options: The task's options; ``task_spec.options`` lists them.

        Raises:
            ValueError: An option is unknown or not allowed; the message lists what is.
        """
        self.closed = True  # until there is something to close
        self._notes = {}
        num_envs = integer(num_envs, "num_envs", InvalidEnvCount, "a positive integer")
        wanted = view(render_mode, render_options)
        self.autoreset_mode = _autoreset_mode(autoreset_mode)
        self._ends_on_success = options.get("terminate") == "success"
        try:
            self._connection = Connection(
                task,
                server=server,
                envs=min(num_envs, 2**32),
                autoreset=self.autoreset_mode.value,
                expert=expert,
                options=options,
                view=wanted,
                reconnect=reconnect,
                shown=self._begun,
                latest=self._latest_episodes,
            )
        except InvalidEnvCount as error:
            raise refuse(InvalidEnvCount, "num_envs", num_envs, error.allowed or "") from None
        self.closed = False
        spec = self.task_spec
        if max_episode_steps not in (None, spec.max_steps):
            self.close()
            allowed = f"allowed is {spec.max_steps}; the option episode_seconds sets others"
            raise refuse(InvalidOption, "max_episode_steps", max_episode_steps, allowed)
        self._copy = truth(copy, "copy")
        self._reset_options = ResetOptions(spec, num_envs)
        self._latest = _Latest()
        self.num_envs = num_envs
        self.render_mode = render_mode
        self._window = Window(0.0) if render_mode == "human" else None
        self.metadata = {
            "render_modes": list(RENDER_MODES),
            "render_fps": render_fps(spec),
            "autoreset_mode": self.autoreset_mode,
        }
        self.single_action_space = action_space(spec)
        self.single_observation_space = observation_space(spec)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)

    @property
    def task_spec(self) -> _trocar.TaskSpec:  # type: ignore[override]
        """What the task looks like under the options of these environments."""
        return self._connection.spec

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Begins new episodes; replies still in flight are dropped.

        Args:
            seed: ``s`` for the first episodes of ``s, s + 1, …``; a seed for each environment,
                where ``None`` goes on to its next episode; or ``None`` for all of these. Any
                non-negative integer is a seed.
            options: ``{"reset_mask": …}`` with a truth value for each environment resets only
                those; the observations of the others are their latest. ``goal``, ``objects`` and
                ``tip`` are as for :meth:`TrocarEnv.reset`: one value for all environments that are
                reset, or an array of shape (num_envs, ...) with one for each. What one environment
                refuses is done in none.
        """
        chosen = self._chosen(options)
        env_ids = np.flatnonzero(chosen).astype(np.uint32)
        placements = self._reset_options.placements(options, env_ids.tolist())
        whole, seeds = self._seeds(seed)
        super().reset(seed=whole)
        self._connection.abandon()
        seeded = np.array([number is not None for number in seeds])
        numbers = np.array([number or 0 for number in seeds], np.uint64)
        if chosen.all():
            everywhere = seeded.all()
            self._latest.whole(self._connection.reset(None, numbers if everywhere else None))
            parts = [] if everywhere else [seeded]
        else:
            self._latest.check()
            parts = [chosen & seeded, chosen & ~seeded]
        for part in parts:
            if part.any():
                part_ids = np.flatnonzero(part).astype(np.uint32)
                given = numbers[part] if seeded[part].all() else None
                self._latest.part(self._connection.reset(part_ids, given))
        if placements:
            self._latest.part(self._connection.arrange(env_ids, placements))
        if self._window is not None:
            self._window.begin(self._connection)
        return self._beginning(chosen)

    def _begun(self, reply: _trocar.Reply) -> tuple[Observation, dict[str, Any]]:
        """Observations and infos of episodes that all begin, or go on elsewhere."""
        self._latest.whole(reply)
        return self._beginning(np.ones(self.num_envs, np.bool_))

    def _beginning(self, chosen: NDArray[np.bool_]) -> tuple[Observation, dict[str, Any]]:
        latest = self._latest.arrays(self._copy)
        expert = {name: np.array(latest.pop(name)) for name in EXPERT}
        zeros = nothing(self.task_spec)
        nowhere = {key: np.full(chosen.shape, zero) for key, zero in zeros.items()}
        infos = _masked(chosen, **nowhere, **{name: latest.pop(name) for name in EPISODE})
        if self._connection.expert:
            infos |= _masked(chosen, **expert)
        return shown(latest), infos

    def _latest_episodes(self) -> Episodes | None:
        """Seeds and numbers of the latest episodes."""
        try:
            latest = self._latest.arrays(copy=False)
        except ResetNeeded:
            return None
        return latest["episode_seed"], latest["episode_index"]

    def step(self, actions: ArrayLike) -> Step:
        """Acts in every environment; ``actions`` has shape (num_envs, action dim)."""
        reply = self._connection.step(actions)
        self._latest.whole(reply)
        return self._transition(reply)

    def send(self, actions: ArrayLike, env_ids: ArrayLike | None = None) -> None:
        """Starts a step of some environments and does not wait for it.

        Args:
            actions: An action for each of them: shape (len(env_ids), action dim).
            env_ids: Which, in increasing order; all if ``None``. They must not be under way.
        """
        self._connection.send(actions, self._env_ids(env_ids))

    def drop_replies(self) -> None:
        """Gives up on the replies of steps under way, which are carried out all the same."""
        self._connection.abandon()

    def recv(self) -> Step:
        """Waits for the step that was started first, and returns a row for each environment of it.

        ``infos["env_id"]`` says which they are. Interrupted by Ctrl-C, it can be called again.
        """
        reply = self._connection.recv()
        self._latest.part(reply)
        observations, rewards, terminations, truncations, infos = self._transition(reply)
        infos["env_id"] = reply.env_ids()
        return observations, rewards, terminations, truncations, infos

    def snapshot(self, env_ids: ArrayLike | None = None) -> Snapshot:
        """Saves the present states of some environments; of all if ``env_ids`` is ``None``.

        None of them may be under way by :meth:`send`.
        """
        return self._connection.snapshot(None if env_ids is None else self._env_ids(env_ids))

    def checkpoint(self) -> None:
        """Saves the present states of all in this process: where ``reconnect`` goes on.

        The one before is forgotten. None of them may be under way by :meth:`send`.
        """
        self._connection.checkpoint()

    def restore(self, snapshot: Snapshot, env_ids: ArrayLike | None = None) -> Observation:
        """Lets environments go on from a snapshot.

        What then follows has the same bits as what followed the snapshot: also which episodes come
        next, so environments that went on from one state have these in common.

        Args:
            snapshot: As many states as there are environments to restore, or one for all of them.
                It may be another's, of the same task and options.
            env_ids: Which environments, in increasing order; all if ``None``.

        Returns:
            The latest observations of all environments.
        """
        ids = None if env_ids is None else self._env_ids(env_ids)
        return self._placed(ids, lambda: self._connection.restore(snapshot, ids))

    def fork(self, source: ArrayLike, env_ids: ArrayLike | None = None) -> Observation:
        """Lets environments go on from the present states of others, as :meth:`restore` does.

        Args:
            source: An environment for each of ``env_ids``, or one for all of them. They may repeat,
                and be among ``env_ids``: what counts is their state before.
            env_ids: Which environments, in increasing order; all if ``None``.

        Returns:
            The latest observations of all environments.
        """
        ids = None if env_ids is None else self._env_ids(env_ids)
        if is_single(source):
            source = [integer(source, "source", InvalidEnvIds, "numbers of environments")]
        sources = self._env_ids(source, "source")
        return self._placed(ids, lambda: self._connection.fork(sources, ids))

    def _placed(
        self, env_ids: NDArray[np.uint32] | None, request: Callable[[], _trocar.Reply]
    ) -> Observation:
        """The latest observations after a request that put environments somewhere."""
        if env_ids is None:
            self._latest.whole(request())
        else:
            self._latest.check()
            self._latest.part(request())
        latest = self._latest.arrays(self._copy)
        for name in (*EPISODE, *EXPERT):
            del latest[name]
        return shown(latest)

    def expert_action(self) -> NDArray[np.float32]:
        """What the scripted expert would do now: (num_envs, action dim); with ``expert=True``."""
        if not self._connection.expert:
            raise refuse(InvalidOption, "expert", False, "make the environments with expert=True")
        self._latest.check()
        return self._latest.arrays(copy=True)["expert_action"]

    def render(self) -> tuple[NDArray[Any], ...] | None:
        """A picture of the present state of each environment, as :meth:`TrocarEnv.render` gives."""
        mode = self.render_mode
        if mode not in PICTURES:
            return None
        return tuple(self._connection.render(env, mode) for env in range(self.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        """Ends the session; ``close`` calls this once."""
        del kwargs
        self._latest = _Latest()
        self._connection.close()

    def _transition(self, reply: _trocar.Reply) -> Step:
        """A reply as Gymnasium's five values, a row for each environment in it."""
        *values, infos, began = reply.transition(self._connection.expert, self._copy)
        if began and self.autoreset_mode is AutoresetMode.SAME_STEP:
            infos |= _final(reply, reply.array("steps") == 0)
        return (*values, infos)

    def _chosen(self, options: dict[str, Any] | None) -> NDArray[np.bool_]:
        """Which environments a reset is about."""
        mask = (options or {}).get("reset_mask")
        if mask is None:
            return np.ones(self.num_envs, np.bool_)
        return truths(mask, "options['reset_mask']", InvalidOption, self.num_envs)

    def _seeds(self, seed: Any) -> tuple[int | None, list[int | None]]:
        """The one number that was given, if it was one, and a seed for each environment."""
        if seed is None:
            return None, [None] * self.num_envs
        if is_single(seed):
            check_seed(seed)
            first = operator.index(seed)
            return first, [check_seed(first + index) for index in range(self.num_envs)]
        each = list(seed)
        if len(each) != self.num_envs:
            expected = f"an integer, or one for each of {self.num_envs} environments"
            raise refused(InvalidRequest, "seed", seed, expected)
        return None, [None if number is None else check_seed(number) for number in each]

    def _env_ids(self, env_ids: ArrayLike | None, field: str = "env_ids") -> NDArray[np.uint32]:
        if env_ids is None:
            return np.arange(self.num_envs, dtype=np.uint32)
        expected = f"one or more increasing numbers below {self.num_envs}"
        array = integers(env_ids, field, InvalidEnvIds, expected)
        if array.size == 0 or not ((array >= 0) & (array < self.num_envs)).all():
            raise refuse(InvalidEnvIds, field, env_ids, f"allowed are {expected}")
        return array.astype(np.uint32)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_latest": _Latest()}


class _Latest:
    """The latest state of every environment, put together only where it is asked for."""

    def __init__(self) -> None:
        self._reply: _trocar.Reply | None = None
        self._arrays: dict[str, NDArray[Any]] | None = None

    def whole(self, reply: _trocar.Reply) -> None:
        """All environments have the state of this reply."""
        self._reply, self._arrays = reply, None

    def part(self, reply: _trocar.Reply) -> None:
        """The environments of this reply have its state, the others that which they had."""
        if self._arrays is None:
            self._arrays = self.arrays(copy=True)
            self._reply = None
        env_ids = reply.env_ids()
        for name, rows in _arrays(reply, copy=False).items():
            self._arrays[name][env_ids] = rows

    def arrays(self, copy: bool) -> dict[str, NDArray[Any]]:
        """Arrays of shape (num_envs, ...) that the caller may keep, unless they are views."""
        if self._arrays is not None:
            return {name: array.copy() for name, array in self._arrays.items()}
        if self._reply is not None:
            return _arrays(self._reply, copy)
        raise ResetNeeded("the environments have no state yet; reset all of them first")

    def check(self) -> None:
        """An error unless every environment has a state."""
        if self._arrays is None and self._reply is None:
            self.arrays(copy=False)


_STATE = [(key, name) for role, key, name, _ in _trocar.INFOS if role in ("episode", "expert")]
"""Infos that tell of a state: their keys and columns."""


def _arrays(reply: _trocar.Reply, copy: bool) -> dict[str, NDArray[Any]]:
    return {
        **observation(reply, copy),
        **{key: reply.array(name, copy) for key, name in _STATE},
    }


def _masked(mask: NDArray[np.bool_], **values: NDArray[Any]) -> dict[str, Any]:
    """Infos as Gymnasium has them: zero where they do not apply, and a mask under ``_key``."""
    infos: dict[str, Any] = {}
    for key, array in values.items():
        array[~mask] = 0
        infos |= {key: array, f"_{key}": mask.copy()}
    return infos


def _final(reply: _trocar.Reply, ended: NDArray[np.bool_]) -> dict[str, Any]:
    """The last observations and infos of episodes that the same step replaced."""
    last, infos = final_observation(reply), reply.infos(expert=False)
    infos["episode_index"] -= 1
    observations = np.full(reply.rows, None, dtype=object)
    for row in np.flatnonzero(ended):
        observations[row] = shown({name: rows[row].copy() for name, rows in last.items()})
    return {
        "final_obs": observations,
        "_final_obs": ended.copy(),
        "final_info": _masked(ended, **infos),
        "_final_info": ended.copy(),
    }


def _autoreset_mode(mode: AutoresetMode | str) -> AutoresetMode:
    if isinstance(mode, AutoresetMode):
        return mode
    for known in AutoresetMode:
        if str(mode) in (known.name, known.name.lower(), known.value):
            return known
    allowed = f"allowed are {[known.name.lower() for known in AutoresetMode]}"
    raise refuse(InvalidOption, "autoreset_mode", mode, allowed)
