"""Arms that speak CRTK: of a live world, of the packages that are installed, or of an owner's own.

A runner needs of an arm what ``dvrk_python`` 2.4 gives it, and no more:

- PSM: ``measured_cp``, ``setpoint_cp``, ``servo_cp``, ``jaw.measured_js``, ``jaw.servo_jp``;
- ECM: ``measured_js``, ``setpoint_js``, ``servo_jp``, ``local.measured_cp``;
- both: ``move_cp`` and ``jaw.move_jp`` where they are moved to the start;
- all: ``enable``, ``home``, ``is_enabled``, ``is_homed``, and ``hold`` where there is one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

import numpy as np

from trocar.dvrk import World, arms, use
from trocar.dvrk import crtk as own_crtk
from trocar.dvrk.deploy.geometry import Numbers, Pose
from trocar.dvrk.deploy.policy import function
from trocar.dvrk.deploy.task import Task
from trocar.errors import InvalidRequest, TrocarError, Unsupported, refuse

try:
    import PyKDL as kdl  # noqa: N813
except ImportError:
    from trocar.dvrk import kdl


class Robot:
    """Some arms, and the clock that they share; simulators have more to tell.

    Args:
        ral: The layer between script and messages, as ``crtk.ral``.
        arms: The arms by name, as ``dvrk.psm`` and ``dvrk.ecm``.
        kdl: The module whose frames they take: PyKDL.
        frames: Where the reference frame of each arm is in the task's scene; where none is given,
            arms tell their poses in the scene.
        utils: ``crtk.utils``, for topics of objects.
    """

    def __init__(
        self,
        ral: Any,
        arms: Mapping[str, Any],
        kdl: Any,
        frames: Mapping[str, Pose] | None = None,
        utils: Callable[..., Any] | None = None,
    ) -> None:
        self.ral, self.arms, self.kdl = ral, dict(arms), kdl
        self.frames = {name: (frames or {}).get(name, Pose.identity()) for name in arms}
        self._utils = utils
        self._topics: dict[str, Any] = {}

    def now(self) -> float:
        """The time, s."""
        return float(self.ral.to_sec(self.ral.now()))

    def rate(self, hertz: float) -> Any:
        """What lets a loop run so many times a second, by its method ``sleep``."""
        return self.ral.create_rate(hertz)

    def reset(self, seed: int) -> None:
        """Begins an episode; a robot's owner lays its objects out before."""

    def object(self, name: str) -> tuple[Any, float]:
        """The pose of an object by its topic ``measured_cp``, in the scene, and its stamp."""
        if name not in self._topics:
            if self._utils is None:
                raise Unsupported(f"{name}: this robot has no topics of objects: use --poses")
            topic = type("Topic", (), {})()
            self._utils(topic, self.ral.create_child(name), 1.0).add_measured_cp()
            self._topics[name] = topic
        pose: tuple[Any, float] = self._topics[name].measured_cp()
        return pose

    def goal(self) -> Numbers | None:
        """The desired goal, where the robot is a simulator that draws one."""
        return None

    def image(self) -> tuple[Numbers | None, float] | None:
        """The target's image point and its stamp, where the robot is a simulator that knows it."""
        return None

    def pictures(self) -> tuple[Any, Any, float, Pose]:
        """Pictures of the left lens and of the right one, their stamp, and the camera in the scene.

        Raises:
            trocar.errors.Unsupported: This robot has none.
        """
        raise Unsupported("this robot has no pictures: say by --pictures where they come from")

    def is_success(self) -> bool | None:
        """Whether the task is done, where the robot is a simulator that knows it."""
        return None

    def close(self) -> None:
        """Ends it."""


class LiveRobot(Robot):
    """The arms of a live world, homed where they are."""

    def __init__(self, world: World, task: Task) -> None:
        use(world)
        ral: Any = own_crtk.ral("deploy")
        made = {name: (arms.ecm if name == "ECM" else arms.psm)(ral, name) for name in task.arms}
        super().__init__(ral, made, kdl, task.bases, own_crtk.utils)
        self.world, self._task = world, task
        names = [element.name for element in task.spec.observation]
        self._image = [names.index(name) for name in IMAGE if name in names]

    def reset(self, seed: int) -> None:
        """Begins the first episode of a seed."""
        self.world.live.reset(seed)
        self.world.look()

    def goal(self) -> Numbers | None:
        """The task's."""
        goal = self.world.live.observation()[2]
        return np.asarray(goal, np.float64) if self._task.spec.has_goals else None

    def image(self) -> tuple[Numbers | None, float] | None:
        """The target's image point by geometry, without a picture."""
        if not self._image:
            return None
        observation = self.world.live.observation()[0].astype(np.float64)
        is_seen, *point = observation[self._image]
        return (np.array(point) if is_seen else None), self.world.now()

    def pictures(self) -> tuple[Any, Any, float, Pose]:
        """Drawn now: of both lenses, or for the endoscope's own tasks from between them."""
        picture = self.world.live.render()
        pose, _ = self.world.live.pose("ECM", "local/measured_cp")
        camera = self._task.bases["ECM"] @ Pose.of_numbers(pose)
        left, right = picture, picture
        if not self._task.moves_camera:
            left, right = np.split(picture, 2)
        return left, right, self.now(), camera

    def is_success(self) -> bool | None:
        """By the task."""
        return bool(self.world.live.world["is_success"])

    def close(self) -> None:
        """Ends the world."""
        use(None)
        self.world.close()


PATIENCE = 5.0
"""How long topics of a robot may take to be there, s."""

MONO, STEREO = (128, 128), (240, 240)
"""Height and width of pictures, pixels: of the endoscope's own tasks, and of pairs."""

IMAGE = ("target in view", "target image x", "target image y")


def live(task: Task, *, server: str | None = None, speed: float | None = None) -> LiveRobot:
    """The arms of a live world of the task.

    Args:
        task: The task.
        server: Name of the server; ``None`` for ``$TROCAR_SERVER``, else a private one.
        speed: How many times as fast as life; ``None`` for lock-step.
    """
    view = {"camera": "endoscope", "image_size": MONO}
    world = World(
        task.spec.id,
        server=server,
        speed=speed,
        options=task.options,
        homing="in_place",
        view=view if task.moves_camera else {"camera": "stereo", "image_size": STEREO},
    )
    return LiveRobot(world, task)


def installed(task: Task, frames: Mapping[str, Pose] | None = None) -> Robot:
    """The arms that the installed packages ``crtk`` and ``dvrk`` reach: over ROS 2, a real robot.

    Args:
        task: The task.
        frames: Where the reference frame of each arm is in the task's scene.

    Raises:
        trocar.errors.Unsupported: A package is missing.
        trocar.errors.TrocarError: A topic of the arms is missing; it is named.
    """
    try:
        crtk, dvrk, found = (import_module(name) for name in ("crtk", "dvrk", "PyKDL"))
    except ImportError as error:
        raise Unsupported(
            f"robot = 'installed': {error.name} is missing; dvrk_python, crtk_python_client and "
            "PyKDL must be installed, as for any script of the robot"
        ) from error
    crtk.ral.parse_argv([])
    ral = crtk.ral("trocar_deploy")
    made = {name: (dvrk.ecm if name == "ECM" else dvrk.psm)(ral, name) for name in task.arms}
    ral.spin()
    try:
        ral.check_connections(PATIENCE)
    except TimeoutError as error:
        raise TrocarError(f"robot = 'installed': {error}") from error
    return Robot(ral, made, found, frames, crtk.utils)


def named(
    name: str, task: Task, frames: Mapping[str, Pose], server: str | None, speed: float | None
) -> Any:
    """``live``, ``installed``, or what ``module:function`` makes of a task: a robot, or a world.

    Raises:
        trocar.errors.InvalidRequest: It is none of these, or has not all arms of the task.
    """
    if name == "live":
        return live(task, server=server, speed=speed)
    if name == "installed":
        return installed(task, frames)
    if ":" not in name:
        allowed = "allowed are live, installed, and module:function"
        raise refuse(InvalidRequest, "robot", name, allowed)
    robot = function(name, "robot")(task)
    if isinstance(robot, World):
        robot = LiveRobot(robot, task)
    missing = [arm for arm in task.arms if arm not in robot.arms]
    if missing:
        allowed = f"it has no arm {missing[0]}; {task.spec.id} moves {', '.join(task.arms)}"
        raise refuse(InvalidRequest, "robot", name, allowed)
    return robot
