"""Where objects, the target's image point and the goal come from."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from trocar.dvrk.deploy.geometry import Numbers, Pose, between
from trocar.dvrk.deploy.limits import Stopped
from trocar.dvrk.deploy.observation import Layout, Reading
from trocar.dvrk.deploy.pictures import Colour, Lens, find, locate
from trocar.dvrk.deploy.task import Task
from trocar.errors import InvalidOption, refuse

if TYPE_CHECKING:
    # The package's import of this module would otherwise import the program `board` before it runs.
    from trocar.dvrk.deploy.board import Board

HISTORY = 64
"""How many places of the endoscope are kept: one of each step."""


class Source(Protocol):
    """Fills in what is read of the scene."""

    def read(self, reading: Reading) -> None:
        """Writes objects, image point and goal, with the stamps of their topics, s.

        Raises:
            Stopped: Something is missing; it is named.
        """


class Topics:
    """A simulator's topics: ``<object>/measured_cp``, and what only a simulator knows."""

    def __init__(self, robot: Any, layout: Layout, goal: Sequence[float] | None = None) -> None:
        self._robot, self._layout = robot, layout
        self._goal = None if goal is None else np.array(goal, np.float64)

    def read(self, reading: Reading) -> None:
        """Reads the topics."""
        for name in self._layout.objects:
            topic = f"{name}/measured_cp"
            frame, stamp = read(topic, partial(self._robot.object, name))
            reading.objects[name], reading.stamps[topic] = Pose.of_frame(frame), stamp
        if self._layout.needs_image:
            seen = self._robot.image()
            if seen is None:
                raise Stopped("target image is missing: no picture and no simulator tells it")
            reading.image, reading.stamps["target image"] = seen
        reading.goal = self._robot.goal() if self._goal is None else self._goal


class Function:
    """An owner's function, which is called before every action, without arguments.

    It returns a dictionary: of an object's name, the pose in the scene (x, y, z in m, then x, y, z,
    w of a quaternion) and its stamp (s); of ``target``, the image point (x, y) or ``None``, and its
    stamp; of ``goal``, the desired goal.
    """

    def __init__(
        self,
        call: Callable[[], Mapping[str, Any]],
        task: Task,
        layout: Layout,
        goal: Sequence[float] | None = None,
    ) -> None:
        self._call, self._layout, self._task = call, layout, task
        self._goal = None if goal is None else np.array(goal, np.float64)

    def read(self, reading: Reading) -> None:
        """Calls the function."""
        told = self._call()
        needed = [*self._layout.objects, *(["target"] if self._layout.needs_image else [])]
        for name in needed:
            if name not in told:
                raise Stopped(f"{name} is missing: the function of --poses told {sorted(told)}")
        for name in self._layout.objects:
            pose, stamp = told[name]
            numbers = np.asarray(pose, np.float64)
            if numbers.shape != (7,) or not np.isfinite(numbers).all():
                raise Stopped(f"{name} = {pose!r}: expected 7 finite numbers")
            reading.objects[name] = Pose.of_numbers(numbers.tolist())
            reading.stamps[f"{name}/measured_cp"] = float(stamp)
        if self._layout.needs_image:
            point, stamp = told["target"]
            reading.image = None if point is None else np.array(point, np.float64)
            reading.stamps["target image"] = float(stamp)
        goal = told.get("goal")
        reading.goal = self._goal if goal is None else np.array(goal, np.float64)


class Pictures:
    """The endoscope's pictures: the target's image point, and objects by both lenses.

    An object's pose has its position alone: it is taken to lie as its frame does, not turned. An
    unseen object keeps its latest stamp, so that the watchdog stops the run.

    Pictures are late: those of a real endoscope by a tenth of a second. The target's image point is
    where it is now, as far as the endoscope has turned since: stamps of pictures and of arms must
    be of one clock.

    Args:
        call: Takes pictures: of the left lens and of the right one, each uint8 (H, W, 3); their
            stamp (s); and the camera between the lenses, in the scene. Where only ``target`` is
            needed, the second and the last may be ``None``; with a board, the last. A target must
            be seen by both lenses.
        layout: What is needed.
        colours: Of ``target`` and of objects.
        goal: Where the goal is from.
        lens: The endoscope.
        board: Tags that tell where the camera is, whatever ``call`` says.

    Raises:
        trocar.errors.InvalidOption: Something that is needed has no colour.
    """

    def __init__(
        self,
        call: Callable[[], tuple[Any, Any, float, Pose | None]],
        layout: Layout,
        colours: Mapping[str, Colour],
        goal: Callable[[], Numbers | None],
        lens: Lens | None = None,
        board: Board | None = None,
    ) -> None:
        needed = [*layout.objects, *(["target"] if layout.needs_image else [])]
        for name in needed:
            if name not in colours:
                allowed = f"expected the colour of {name}: --colour {name}=R,G,B"
                raise refuse(InvalidOption, "--colour", sorted(colours), allowed)
        self._call, self._layout, self._colours = call, layout, dict(colours)
        self._lens, self._goal, self._board = lens or Lens(), goal, board
        self._latest: dict[str, tuple[Pose, float]] = {}
        self._cameras: deque[tuple[float, Pose]] = deque(maxlen=HISTORY)

    def read(self, reading: Reading) -> None:
        """Takes pictures and detects the objects in them."""
        left, right, stamp, camera = self._call()
        if self._layout.needs_image:
            seen = [
                find(each, self._colours["target"]) for each in (left, right) if each is not None
            ]
            # Image points of a task are those of a camera between the lenses.
            points = [point for point in seen if point is not None]
            point = np.mean(points, axis=0) if len(points) == len(seen) else None
            reading.image = self._now(point, stamp, reading)
            reading.stamps["target image"] = stamp
        if self._board is not None and self._layout.objects:
            camera = self._board.camera(left, right, self._lens)
        for name in self._layout.objects:
            place = None
            if camera is not None:
                place = locate(left, right, self._colours[name], self._lens, camera)
            if place is not None:
                self._latest[name] = (Pose(np.eye(3), place), stamp)
            if name not in self._latest:
                what = "its colour is" if camera else "three tags of the board are"
                raise Stopped(f"{name} is missing: {what} not in both pictures")
            pose, reading.stamps[f"{name} in pictures"] = self._latest[name]
            reading.objects[name] = pose
        reading.goal = self._goal()

    def _now(self, point: Numbers | None, stamp: float, reading: Reading) -> Numbers | None:
        """An image point of the picture of a stamp, as the endoscope stands now."""
        told = [at for topic, at in reading.stamps.items() if "local/measured_cp" in topic]
        if not told:
            return point
        now = told[0]
        if self._cameras and now <= self._cameras[-1][0]:
            self._cameras.clear()
        self._cameras.append((now, reading.camera))
        later = [index for index, (at, _) in enumerate(self._cameras) if at > stamp]
        if point is None or not later or later[0] == 0:
            return point
        (start, first), (end, second) = (self._cameras[later[0] + step] for step in (-1, 0))
        then = between(first, second, (stamp - start) / (end - start))
        return self._lens.turned(point, then, reading.camera)


def checked_goal(goal: Numbers | None, task: Task) -> Numbers | None:
    """A goal of the right shape; tracking tasks have zeros.

    Raises:
        Stopped: There is none, or it has another shape.
    """
    elements = task.spec.goal
    if not elements:
        return None
    if goal is None and task.moves_camera:
        return np.zeros(len(elements))
    names = ", ".join(element.name for element in elements)
    if goal is None:
        raise Stopped(f"goal is missing: {task.spec.id} needs {names}; give --goal")
    if goal.shape != (len(elements),) or not np.isfinite(goal).all():
        raise Stopped(f"goal = {goal.tolist()}: expected finite numbers for {names}")
    return goal


def read(topic: str, get: Callable[[], Any]) -> Any:
    """What a topic says.

    Raises:
        Stopped: No message arrived.
    """
    try:
        return get()
    except (TimeoutError, RuntimeWarning) as error:
        raise Stopped(f"{topic} is missing: {error}") from error
