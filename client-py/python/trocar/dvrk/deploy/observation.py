"""Observations from what an arm's topics say, laid out as the task's specification has it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.dvrk.deploy.camera import misorientation
from trocar.dvrk.deploy.geometry import Numbers, Pose, euler_xyz
from trocar.dvrk.deploy.task import AXES, EULER, TIP, Task, split
from trocar.errors import Unsupported

Seen = Any
"""What a policy sees: a dictionary of arrays, or the one array of a task without goals."""

WRIST_FROM_LINK = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""The wrist link of observations in the frame of ``measured_cp``: its y axis is along the jaws, its
z axis is their hinge. Source: the tasks' Observation Space."""

HALF_TURN = np.diag([1.0, -1.0, -1.0])
"""The camera of observations, whose z axis is against the view, in dVRK's camera frame."""

JOINTS = ("yaw", "pitch", "insertion", "roll", "wrist pitch", "wrist yaw")

UNITS = ("m", "rad", "1", "")
"""Units of elements that topics have."""


@dataclass
class Reading:
    """What was read of arms and of what they work on, at one moment."""

    wrists: dict[str, Pose] = field(default_factory=dict)
    """``measured_cp`` of PSMs, in the scene."""
    jaws: dict[str, float] = field(default_factory=dict)
    """``jaw/measured_js`` of PSMs, rad."""
    joints: dict[str, Numbers] = field(default_factory=dict)
    """``measured_js`` of arms whose joints are asked for, rad; index 2 in m."""
    camera: Pose = field(default_factory=Pose.identity)
    """``local/measured_cp`` of the ECM."""
    objects: dict[str, Pose] = field(default_factory=dict)
    """Poses of objects, in the scene."""
    image: Numbers | None = None
    """The image point of the target, in halves of the picture; ``None`` where it is not seen."""
    goal: Numbers | None = None
    """The desired goal."""
    stamps: dict[str, float] = field(default_factory=dict)
    """When each of these was measured, by topic, s."""


Getter = Callable[[Reading], float]


class Layout:
    """The elements of a task's observation and goals, each with what it is read from.

    Raises:
        trocar.errors.Unsupported: No topic of a robot has an element of the task; it is named.
    """

    def __init__(self, task: Task) -> None:
        self._task = task
        self._of_goal = task.spec.goal or []
        self._observed = [self._getter(element) for element in task.spec.observation]
        self._achieved = [self._getter(element) for element in self._of_goal]
        elements = task.spec.observation
        self._saturating = np.array([element.saturates for element in elements])
        self._ends = np.array([[element.min, element.max] for element in elements], np.float32)
        names = {element.name for element in (*elements, *self._of_goal)}
        self.needs_joints = any(name.endswith(" joint") for name in names)
        """Whether ``measured_js`` is needed."""
        self.needs_image = any(name.startswith("target") for name in names)
        """Whether the target's image point is needed."""
        objects = [self._object(split(name)[0]) for name in names]
        self.objects = tuple(dict.fromkeys(name for name in objects if name))
        """The objects whose poses are needed."""

    def seen(self, reading: Reading) -> Seen:
        """What a policy sees: float32 arrays, as Gymnasium's environment of the task has them."""
        observation = np.array([get(reading) for get in self._observed], np.float32)
        low, high = self._ends.T
        clipped = np.clip(observation, low, high)
        observation = np.where(self._saturating, clipped, observation)
        if not self._of_goal:
            return observation
        return {
            "observation": observation,
            "achieved_goal": self.achieved(reading),
            "desired_goal": np.array(reading.goal, np.float32),
        }

    def achieved(self, reading: Reading) -> NDArray[np.float32]:
        """The achieved goal by what was measured: float32 (goal dim)."""
        return np.array([get(reading) for get in self._achieved], np.float32)

    def _object(self, what: str) -> str | None:
        what = what.split(" from ")[0]
        if what in self._task.objects:
            return what
        return self._task.places[what][0] if what in self._task.places else None

    def _getter(self, element: Any) -> Getter:
        """What reads an element, by its name, frame and unit."""
        name = element.name
        get = None
        if element.unit in UNITS:
            what, part = split(name)
            arm, own = self._owner(what)
            get = self._other(*self._owner(name))
            if get is None and part in AXES:
                get = self._position(arm, own, element.frame, AXES.index(part))
            elif get is None and part in EULER:
                get = self._angle(arm, own, element.frame, EULER.index(part))
        if get is None:
            raise Unsupported(
                f"{self._task.spec.id}: no topic of a robot has `{name}` ({element.frame or '-'}, "
                f"{element.unit}); allowed are options whose state has wrists, jaws, joints, "
                "objects, the camera or the target's image point, in m and rad"
            )
        return get

    def _owner(self, what: str) -> tuple[str, str]:
        """The arm that an element is of, the only one where it names none; and the rest."""
        first, _, rest = what.partition(" ")
        return (first, rest) if first in self._task.arms else (self._task.arms[0], what)

    def _position(self, arm: str, what: str, frame: str, axis: int) -> Getter | None:
        if what in ("wrist", "tip") and frame == "scene":
            lever = TIP if what == "tip" else np.zeros(3)
            return lambda now: (now.wrists[arm] @ Pose(np.eye(3), lever)).position[axis]
        if what == "camera" and frame == "rcm":
            return lambda now: now.camera.position[axis]
        if what == "camera" and frame == "world":
            return lambda now: (self._task.bases["ECM"] @ now.camera).position[axis]
        what, _, origin = what.partition(" from ")
        if frame != "scene" or self._object(what) is None:
            return None
        if not origin:
            return lambda now: self._place(now, what).position[axis]
        arm = origin.split(" ")[0] if origin != "wrist" else arm
        return lambda now: self._place(now, what).position[axis] - now.wrists[arm].position[axis]

    def _angle(self, arm: str, what: str, frame: str, index: int) -> Getter | None:
        if what in ("wrist link", "measured wrist link") and frame == "scene":
            return lambda now: euler_xyz(now.wrists[arm].rotation @ WRIST_FROM_LINK)[index]
        if what == "camera" and frame == "rcm":
            return lambda now: euler_xyz(now.camera.rotation @ HALF_TURN)[index]
        if what == "camera" and frame == "world":
            turn = self._task.bases["ECM"].rotation
            return lambda now: euler_xyz(turn @ now.camera.rotation @ HALF_TURN)[index]
        if frame != "scene" or self._object(what) is None:
            return None
        return lambda now: euler_xyz(self._place(now, what).rotation)[index]

    def _other(self, arm: str, what: str) -> Getter | None:
        if what in ("jaw", "jaw joint"):
            return lambda now: now.jaws[arm]
        joint = what.removesuffix(" joint")
        if joint != what and joint in JOINTS:
            index = JOINTS.index(joint)
            return lambda now: now.joints[arm][index]
        if what == "target in view":
            return lambda now: float(now.image is not None)
        if what in ("target image x", "target image y"):
            index = int(what.endswith("y"))
            return lambda now: 0.0 if now.image is None else now.image[index]
        if what == "misorientation":
            return self._misorientation
        return None

    def _misorientation(self, now: Reading) -> float:
        base = self._task.bases["ECM"]
        return misorientation(base @ self._task.reference, base @ now.camera)

    def _place(self, now: Reading, what: str) -> Pose:
        if what in self._task.places:
            body, body_from_place = self._task.places[what]
            return now.objects[body] @ body_from_place
        return now.objects[what]


def missing(needed: Sequence[str], given: Mapping[str, Any]) -> list[str]:
    """Which names are not given."""
    return [name for name in needed if name not in given]
