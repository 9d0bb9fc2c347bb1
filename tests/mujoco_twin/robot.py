"""The twin as a robot that ``trocar.dvrk.deploy`` drives; episodes begin as Trocar's own do."""

from __future__ import annotations

from typing import Any

import numpy as np

from mujoco_twin.kinematics import Pose
from mujoco_twin.model import Numbers
from mujoco_twin.twin import NAME, Twin
from trocar import dvrk
from trocar.dvrk import crtk
from trocar.dvrk.deploy import Robot, Task
from trocar.dvrk.deploy.geometry import Pose as Place
from trocar.dvrk.deploy.observation import Layout, Reading

try:
    import PyKDL as kdl  # noqa: N813
except ImportError:
    from trocar.dvrk import kdl


class TwinRobot(Robot):
    """PSM1 of the twin, in the world of a task.

    The objects and the goal of an episode are those of the task's own episode of the same seed, so
    that results in both engines are paired.

    Args:
        task: The task.
        friction: Coefficient of friction of the jaws; ``None`` for that of ``contact.py``.
        pose_error: By how much the positions of objects that are told may be off along each axis,
            m. The error is drawn uniformly for each episode, and stays.
        errors: Whether the arm has the errors of ``cables.py``, drawn for each episode.
    """

    def __init__(
        self,
        task: Task,
        *,
        friction: float | None = None,
        pose_error: float = 0.0,
        errors: bool = False,
    ) -> None:
        if not 0.0 <= pose_error < np.inf:
            raise ValueError(f"pose_error {pose_error!r}: allowed are numbers from 0 on")
        self.twin = Twin(task.spec.id, friction=friction)
        self.world = dvrk.World(live=self.twin, in_world=True)
        dvrk.use(self.world)
        ral: Any = crtk.ral("mujoco_twin")
        super().__init__(ral, {NAME: dvrk.psm(ral, NAME)}, kdl, utils=crtk.utils)
        self._task, self._layout = task, Layout(task)
        self._starts = dvrk.World(task.spec.id, options=task.options, homing="in_place").live
        *_, rcm = self._starts.describe(NAME)
        self._rcm = Pose.of(np.array(rcm))
        self._goal: Numbers = np.zeros(3)
        self._pose_error, self._error, self._errs = pose_error, np.zeros(3), errors

    def reset(self, seed: int) -> None:
        """Begins the episode that begins as the first one of a seed does."""
        self._starts.reset(seed)
        local, _ = self._starts.pose(NAME, "local/setpoint_cp")
        wrist = (self._rcm @ Pose.of(np.array(local))).numbers()
        objects = {name: self._starts.object(name) for name in self.twin.objects}
        errors = np.random.default_rng([seed, 1]) if self._errs else None
        self.twin.begin(wrist, objects, errors=errors)
        self._goal = np.asarray(self._starts.observation()[2], np.float64)
        bound = self._pose_error
        self._error = np.random.default_rng(seed).uniform(-bound, bound, 3)
        self.world.look()

    def object(self, name: str) -> tuple[Any, float]:
        """The pose of an object as it is told, and its stamp."""
        frame, stamp = super().object(name)
        return kdl.Frame(frame.M, frame.p + kdl.Vector(*self._error)), stamp

    def goal(self) -> Numbers:
        """The desired goal."""
        return self._goal

    def is_success(self) -> bool | None:
        """Whether the task is done, by where the objects truly are."""
        objects = {
            name: self.twin.object(self.world.objects[name]) for name in self._layout.objects
        }
        reading = Reading(objects={name: Place.of_numbers(at) for name, at in objects.items()})
        achieved = self._layout.achieved(reading)
        return bool(self._task.spec.compute_success(achieved, self._goal.astype(np.float32)))

    def close(self) -> None:
        """Ends it."""
        dvrk.use(None)
        self.world.close()
        self._starts.close()


def clean(task: Task) -> TwinRobot:
    """The robot for ``--robot mujoco_twin.robot:clean``."""
    return TwinRobot(task)
