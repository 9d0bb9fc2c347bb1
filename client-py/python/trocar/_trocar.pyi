"""Python bindings of the Trocar client: connections, sessions, replies as arrays, errors.

Everything that waits lets other threads run, and Ctrl-C interrupts it. Exceptions are those of
`trocar.errors`.
"""

import os
from collections.abc import Mapping, Sequence
from typing import Any, Literal, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "BINARY",
    "INFOS",
    "PRIVATE_SERVER",
    "STAGES",
    "TASKS",
    "Client",
    "Element",
    "GoalPart",
    "ImageSpec",
    "LiveWorld",
    "Network",
    "OptionSpec",
    "Reply",
    "Session",
    "Snapshot",
    "TaskSpec",
    "__version__",
    "seed_of",
    "split_snapshot",
    "unique_name",
]

__version__: str
PRIVATE_SERVER: str
BINARY: str
STAGES: tuple[str, ...]
TASKS: dict[str, tuple[int, float, list[str]]]
"""Of each of Trocar's own tasks: steps of an episode, the nominal rate in Hz, tags."""
INFOS: tuple[tuple[str, str, str, str], ...]
"""Of each column that infos have: role, key, name in :class:`Reply`, kind of numbers.

Roles are ``step``, ``fault``, ``episode`` and ``expert``."""

def unique_name() -> str:
    """A name for a private server that no other has."""

def seed_of(number: bytes) -> int:
    """The seed of a number of any size, given by its bytes, the least significant one first."""

def split_snapshot(data: bytes) -> list[bytes]:
    """The parts of an exported snapshot, one for each environment."""

@final
class Client:
    """A connection to one server; it ends with the last of this object and its sessions."""

    @staticmethod
    def connect(name: str) -> Client:
        """Connects to the running server of that name."""
    @staticmethod
    def launch(private: str, binary: str | os.PathLike[str]) -> Client:
        """Connects to a private server, which ``binary`` is started for if need be."""
    @property
    def name(self) -> str:
        """The server's name."""
    @property
    def pid(self) -> int:
        """The server's process id, in its own process namespace."""
    @property
    def epoch(self) -> int:
        """The run of the server: a restarted one has another."""
    @property
    def version(self) -> str:
        """Version of the server's program."""
    @property
    def max_envs(self) -> int:
        """Most environments that one session may have."""
    def tasks(self) -> list[str]:
        """The ids of the tasks that the server offers."""
    def describe(self, task: str, options: Mapping[str, Any] | None = None) -> TaskSpec:
        """What a task looks like under some options."""
    def open(
        self,
        task: str,
        *,
        envs: int,
        seed: int,
        autoreset: str,
        options: Mapping[str, Any] | None = None,
        view: Mapping[str, Any] | None = None,
    ) -> Session:
        """Opens a session: one task, N environments, one seed, its options."""
    def open_live(
        self,
        task: str,
        *,
        seed: int = 0,
        options: Mapping[str, Any] | None = None,
        homing: str = "to_zero",
        speed: float | None = None,
        world: int | None = None,
        intervention: bool = False,
        view: Mapping[str, Any] | None = None,
    ) -> LiveWorld:
        """Opens a session with a live world: in lock-step, or ``speed`` times as fast as life.

        ``homing`` is ``to_zero`` or ``in_place``; ``world`` a session whose world is to be shared;
        with ``intervention`` a page of the viewer that may drive takes arms over from this session;
        ``view`` says how :meth:`LiveWorld.render` draws.
        """
    def status(self) -> dict[str, Any]:
        """The server's clients and sessions, and how fast it runs."""
    def limits(self) -> dict[str, int | None]:
        """What one client, a process, may have of the server; ``None`` where it has no limit.

        ``session_envs`` environments in a session; ``sessions``, ``envs``, ``memory_bytes`` and
        ``threads`` in all.
        """
    def viewer(self) -> str:
        """Where the live viewer is, as ``address:port``; it is started where there is none."""
    def driving_page(self) -> str:
        """Where the viewer's page is that may drive arms: an address with a token."""
    def shut_down(self) -> None:
        """Ends the server, for all of its clients."""

@final
class Session:
    """N environments of one task, which live in the server until this is closed."""

    @property
    def id(self) -> int:
        """Its number, unique in this run of the server."""
    @property
    def epoch(self) -> int:
        """The run of the server."""
    @property
    def envs(self) -> int:
        """Number of environments."""
    @property
    def spec(self) -> TaskSpec:
        """The task under the session's options."""
    @property
    def closed(self) -> bool:
        """Whether it was closed."""
    def want_expert(self, wanted: bool) -> None:
        """Whether replies shall carry the scripted expert's action."""
    def in_flight(self) -> int:
        """Number of requests whose replies can be received."""
    def reset(
        self,
        env_ids: NDArray[np.uint32] | None = None,
        seeds: NDArray[np.uint64] | None = None,
        episodes: NDArray[np.uint64] | None = None,
    ) -> Reply:
        """Resets environments and waits; with another request in flight it is refused.

        With seeds, they begin these episodes of them, or the first ones.
        """
    def arrange(
        self,
        placements: Sequence[
            tuple[Sequence[float] | None, Mapping[str, Sequence[float]], Sequence[float] | None]
        ],
        env_ids: NDArray[np.uint32] | None = None,
    ) -> Reply:
        """Lets episodes that have only begun begin as placements ask for, and waits."""
    def step(self, actions: ArrayLike, single: bool = False) -> Reply:
        """Steps all environments and waits; with another request in flight it is refused.

        ``single`` says that the user's action space has no axis of environments.
        """
    def send(self, actions: ArrayLike, env_ids: NDArray[np.uint32]) -> None:
        """Starts a step of some environments."""
    def recv(self) -> Reply:
        """Waits for the reply to the oldest request; where interrupted, it can be repeated."""
    def snapshot(self, env_ids: NDArray[np.uint32] | None = None) -> Snapshot:
        """Saves the states of environments and waits."""
    def restore(self, snapshot: Snapshot, env_ids: NDArray[np.uint32] | None = None) -> Reply:
        """Lets environments go on from a snapshot of this session, and waits."""
    def fork(self, sources: NDArray[np.uint32], env_ids: NDArray[np.uint32] | None = None) -> Reply:
        """Lets environments go on from the present states of others, and waits."""
    def render(self, env_id: int, depth: bool) -> NDArray[Any]:
        """Draws an environment: uint8 (H, W, 3), or with ``depth`` float32 (H, W) in m."""
    def export_snapshot(self, snapshot: Snapshot) -> bytes:
        """A snapshot of this session as bytes."""
    def import_snapshot(self, data: bytes) -> Snapshot:
        """Brings an exported snapshot into this session."""
    def abandon(self) -> None:
        """Gives up on the replies of all requests in flight."""
    def close(self) -> None:
        """Ends the session; once is enough, more does no harm."""

@final
class LiveWorld:
    """A world in the server whose arms this process commands, until it is closed.

    Stamps are seconds since the world began; a tick is 1/240 s. What is read is as of the latest
    :meth:`advance`. Poses are x, y, z in m, then x, y, z, w of a unit quaternion.
    """

    @property
    def id(self) -> int:
        """The number of its session."""
    @property
    def spec(self) -> TaskSpec:
        """The task under the session's options."""
    @property
    def arms(self) -> list[str]:
        """Names of its arms."""
    @property
    def objects(self) -> list[str]:
        """Names of its objects."""
    @property
    def speed(self) -> float | None:
        """How many times as fast as life its time passes; ``None`` in lock-step."""
    @property
    def closed(self) -> bool:
        """Whether it was closed."""
    @property
    def ticks(self) -> int:
        """Ticks that have passed since the world began."""
    @property
    def world(self) -> dict[str, Any]:
        """``ticks``, ``steps``, ``reward``, ``is_success``, ``terminated``, ``late``.

        Also ``lost_events``: events that this client came too late for.
        """
    def describe(self, arm: str) -> tuple[list[str], bool, list[float]]:
        """An arm's joints, whether it has a jaw, where its remote centre is in the world."""
    def command(
        self,
        arm: str,
        topic: str,
        numbers: Sequence[float] | NDArray[Any] = ...,
        more: Sequence[float] | NDArray[Any] = ...,
        text: str = "",
    ) -> None:
        """Gives a command to an arm with the next :meth:`advance`."""
    def advance(self, ticks: int, until_event: bool = False) -> int:
        """Gives the commands, and lets so many ticks pass; how many did.

        ``until_event`` stops after a tick in which an arm told something.
        """
    def events(self) -> list[tuple[str, float, str, Any]]:
        """What arms have told since the last call: arm, stamp, topic, value."""
    def operating_state(self, arm: str) -> tuple[str, bool, bool]:
        """An arm's operating state, whether it is homed, whether it is busy."""
    def joints(
        self, arm: str, *, setpoint: bool = False, jaw: bool = False
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
        """Positions, velocities and stamp of the joints, or of the jaw."""
    def pose(self, arm: str, topic: str) -> tuple[list[float], float]:
        """A pose of an arm, and its stamp, which is 0 without a tool."""
    def twist(self, arm: str) -> tuple[list[float], float]:
        """The twist of an arm's end, and its stamp, which is 0 without a tool."""
    def status(self, arm: str) -> tuple[float, int, str]:
        """The ratio of moves, the process that drives the arm, its reference frame."""
    def ask(
        self,
        arm: str,
        question: str,
        numbers: Sequence[float] | NDArray[Any] = ...,
        more: Sequence[float] | NDArray[Any] = ...,
    ) -> tuple[list[float], str]:
        """Asks a service of an arm: numbers and an empty text, or none and why.

        ``task/set_point`` is where the arm's numbers of a task's action ask it to be: of a PSM a
        pose and the jaw angle, of the ECM joints. ``task/action`` has the numbers that bring a PSM
        from one pose and jaw angle to others, as near as one action can.
        """
    def observation(
        self,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
        """Observation, achieved and desired goal of the task."""
    def object(self, name: str) -> list[float]:
        """Where an object is in the world."""
    def snapshot(self) -> Snapshot:
        """Keeps the state of the world in the server, with what its arms are about."""
    def restore(self, snapshot: Snapshot) -> None:
        """Brings the world back to a state that was kept; ticks and stamps go on.

        Every arm tells its operating state. Refused while another client drives an arm.
        """
    def reset(self, seed: int) -> None:
        """Begins the first episode of a seed; ticks and stamps go on.

        Every arm tells its operating state. Refused while another client drives an arm; a page that
        took the arms over lets go.
        """
    def recording(self) -> bytes:
        """What led to the present state from the beginning on: a file for ``trocar replay``."""
    def render(self, depth: bool = False) -> NDArray[Any]:
        """Draws the world: uint8 (H, W, 3), or with ``depth`` float32 (H, W) in m."""
    def close(self) -> None:
        """Ends the session; once is enough, more does no harm."""

@final
class Reply:
    """The reply to a reset, step, restore or fork. Row r belongs to environment ``env_ids()[r]``.

    With ``copy=False``, arrays are read-only, lie in shared memory and keep the reply there.
    """

    @property
    def rows(self) -> int:
        """Number of rows."""
    @property
    def has_goals(self) -> bool:
        """Whether the task has goals; without them, arrays of goals have no columns."""
    @property
    def has_state(self) -> bool:
        """Whether the state is wanted, which it is unless only pictures are."""
    def env_ids(self) -> NDArray[np.int64]:
        """The environment of each row."""
    def array(self, name: str, copy: bool = True) -> NDArray[Any]:
        """The column of that name, as ``trocar_client::Reply`` has it: (rows) or (rows, width)."""
    def infos(self, expert: bool) -> dict[str, NDArray[Any]]:
        """What infos tell of every row, by key; with ``expert`` also what the expert would do."""
    def images(self, copy: bool = True) -> dict[str, NDArray[Any]]:
        """Pictures by name, ``rgb`` or ``rgb_left`` and so on: arrays of shape (rows, ...)."""
    def final_images(self, copy: bool = True) -> dict[str, NDArray[Any]]:
        """As ``images``, of episodes that a same-step autoreset replaced."""
    def transition(
        self, expert: bool, copy: bool
    ) -> tuple[
        Any,
        NDArray[np.float32],
        NDArray[np.bool_],
        NDArray[np.bool_],
        dict[str, Any],
        bool,
    ]:
        """What Gymnasium's vector environments return of a step, in one call.

        The last value says whether somewhere an episode began.
        """
    def outcome(self, expert: bool) -> tuple[float, bool, bool, dict[str, Any]]:
        """Reward, terminated, truncated and infos of row 0, as plain numbers."""

@final
class Network:
    """A policy of an ONNX file, as ``trocar rollout --policy`` runs it."""

    def __new__(cls, name: str, content: bytes) -> Network:
        """What the file ``name`` holds."""
    @property
    def task(self) -> str | None:
        """The task that it was trained for, if the file says so."""
    @property
    def options(self) -> str | None:
        """The options of the task that it was trained with, JSON, if the file says so."""
    @property
    def card(self) -> str | None:
        """How it was trained and how well it does, JSON, if the file says so."""
    def check(self, spec: TaskSpec) -> None:
        """An error unless it can act in a task."""
    def act(
        self,
        observation: NDArray[np.float32],
        achieved: NDArray[np.float32],
        desired: NDArray[np.float32],
        numbers: int,
    ) -> NDArray[np.float32]:
        """The action that it chooses, of so many numbers; goals of tasks without are empty."""

@final
class Snapshot:
    """States of environments, which stay in the server until this is gone or the session ends."""

    def __len__(self) -> int: ...
    def select(self, indices: list[int]) -> Snapshot:
        """The states of these indices, in that order."""

@final
class TaskSpec:
    """A task as its clients see it, under one choice of options."""

    def __new__(cls, encoded: bytes) -> TaskSpec:
        """The specification that pickling wrote."""
    def __eq__(self, other: object, /) -> bool: ...
    __hash__: None  # type: ignore[assignment]
    @property
    def id(self) -> str:
        """Registered name with version, e.g. ``NeedleReach-v0``."""
    @property
    def summary(self) -> str:
        """One sentence for people."""
    @property
    def max_steps(self) -> int:
        """Steps after which an episode is truncated."""
    @property
    def seconds_per_step(self) -> float:
        """Simulated time of one step, s."""
    @property
    def action(self) -> list[Element]:
        """The action vector, element by element."""
    @property
    def observation(self) -> list[Element]:
        """The state observation, element by element."""
    @property
    def goal(self) -> list[Element] | None:
        """Achieved and desired goal; ``None`` for tasks without goals."""
    @property
    def goal_parts(self) -> list[GoalPart]:
        """The parts of a goal that is reached part by part; none where it is one whole."""
    @property
    def has_goals(self) -> bool:
        """Whether the task has goals."""
    @property
    def has_tissue(self) -> bool:
        """Whether there are soft bodies: then infos tell what is done to them."""
    @property
    def images(self) -> ImageSpec | None:
        """The pictures of an observation; ``None`` where they are not asked for."""
    @property
    def reward(self) -> Literal["sparse", "dense", "state"]:
        """Which reward is given; ``state`` is no function of goals."""
    @property
    def options(self) -> list[OptionSpec]:
        """The options this task knows."""
    def compute_reward(self, achieved: ArrayLike, desired: ArrayLike) -> NDArray[np.float32]:
        """Rewards of goals of shape (..., goal dim), as the server gives them: float32 (...)."""
    def compute_success(self, achieved: ArrayLike, desired: ArrayLike) -> NDArray[np.bool_]:
        """Whether goals of shape (..., goal dim) are reached: bool (...)."""
    @property
    def relative(self) -> list[Element]:
        """The relative features, element by element; none for tasks without goals."""
    @property
    def relative_program(self) -> list[dict[str, Any]]:
        """How they are computed from x: state, achieved and desired goal, one after the other.

        Some numbers each, in the order of :attr:`relative`. What all have is ``kind``:

        - ``offset``: ``count`` numbers (to - from) / scale of two places; clipped to ±3 where
          ``bound`` is ``clip``, else their tanh. A place is ``fixed``, or x[at], or where there are
          ``angles`` x[at] + R(x[angles]) ``offset``.
        - ``rotation``: the first two columns of R(x[seen_from])ᵀ R(x[of]), or of R(x[of]) where
          ``seen_from`` is ``None``; R = Rz(yaw) Ry(pitch) Rx(roll) of three numbers.
        - ``line``: 2 dx dy, 2 dy dz, 2 dx dz, dx² - dy², dy² - dz² of
          d = R(x[seen_from])ᵀ R(x[of]) ``direction``.
        """
    def features(
        self, observation: ArrayLike, achieved: ArrayLike, desired: ArrayLike
    ) -> NDArray[np.float32]:
        """As :func:`trocar.features`."""

@final
class ImageSpec:
    """The pictures of an observation.

    Their cameras are OpenCV's: x to the right, y down, z forward; pixel (u, v), from 0, shows what
    lies along ((u - cx) / fx, (v - cy) / fy, 1).
    """

    @property
    def kinds(self) -> list[str]:
        """What there is of each view: ``rgb``, ``depth``, ``mask``, ``points``."""
    @property
    def views(self) -> list[str]:
        """What is appended to the names of each view: nothing, or ``_left`` and ``_right``."""
    @property
    def height(self) -> int:
        """Rows of a picture."""
    @property
    def width(self) -> int:
        """Columns of a picture."""
    @property
    def intrinsics(self) -> list[float]:
        """Focal lengths and optical axis, pixels: fx, fy, cx, cy."""
    @property
    def camera_from_world(self) -> list[list[list[float]]]:
        """Where each view's camera stands: rows of OpenCV's [R | t]; empty where it moves."""
    @property
    def far(self) -> float:
        """Greatest depth, m: that of pixels that show nothing."""
    @property
    def reach(self) -> list[float]:
        """Largest x and y of points, m."""
    @property
    def bodies(self) -> list[str]:
        """Names of the bodies: number n of a mask is the name at n - 1, and 0 is nothing."""
    @property
    def with_state(self) -> bool:
        """Whether the state is wanted besides."""

@final
class GoalPart:
    """Some numbers of a goal that belong together: a position, a share, a force.

    The goal is reached where every part is. Part ``p`` is, where the Euclidean distance of
    ``achieved[p.start : p.start + p.count]`` from the desired ones is below ``p.tolerance``. The
    dense reward is minus the sum of these distances, each over ``p.unit``.
    """

    @property
    def name(self) -> str:
        """What it is, e.g. ``exposed``."""
    @property
    def start(self) -> int:
        """The first of its numbers in the goal."""
    @property
    def count(self) -> int:
        """How many numbers it has."""
    @property
    def tolerance(self) -> float:
        """Largest distance at which it is reached, exclusive, in its unit."""
    @property
    def unit(self) -> float:
        """The distance that takes 1 from the dense reward; no option changes it."""

@final
class Element:
    """One element of a vector: what it means, where, in which unit and range."""

    @property
    def name(self) -> str:
        """Meaning, e.g. ``tip position x``."""
    @property
    def frame(self) -> str:
        """Coordinate frame, e.g. ``world``; empty where none applies."""
    @property
    def unit(self) -> str:
        """SI unit, ``1`` where dimensionless."""
    @property
    def min(self) -> float:
        """Smallest value."""
    @property
    def max(self) -> float:
        """Largest value."""
    @property
    def saturates(self) -> bool:
        """Whether an object that is lost leaves the range; the element then stays at the edge."""
    def __eq__(self, other: object, /) -> bool: ...
    __hash__: None  # type: ignore[assignment]

@final
class OptionSpec:
    """One option of a task: its name, its default and what is allowed."""

    @property
    def name(self) -> str:
        """Keyword, e.g. ``reward``."""
    @property
    def summary(self) -> str:
        """One sentence for people."""
    @property
    def default(self) -> bool | float | str | list[float] | list[str] | dict[str, list[float]]:
        """The value where none is given."""
    @property
    def allowed(self) -> str:
        """What is accepted, in words."""
