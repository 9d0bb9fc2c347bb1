"""A world in MuJoCo that ``trocar.dvrk`` drives as it drives a live world of the server."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from mujoco_twin import model as scenes
from mujoco_twin.arm import TICK, Controller
from mujoco_twin.cables import Cables, moved_base
from mujoco_twin.contact import TIMESTEP
from mujoco_twin.kinematics import Kinematics, Pose
from mujoco_twin.model import FINGERS, JOINTS, SCENES, Numbers

STEPS = round(TICK / TIMESTEP)
"""Time steps of the engine in a tick."""

NAME = "PSM1"

SETTLING = 24
"""Ticks in which objects come to rest where they were laid, before an episode begins."""

AWAY = np.array([1.0, 0.0, -1.0, 0.0, 0.0, 0.0, 1.0])
APART = np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
"""Where the first object is before it is laid, and from there the next one, m."""


class Twin:
    """PSM1 and a task's objects; what can be called is what ``trocar.dvrk`` calls of a live world.

    Poses are x, y, z in m, then x, y, z, w of a unit quaternion. Time passes in :meth:`advance`.

    Args:
        task: Id of the task whose scene it is.
        friction: Coefficient of friction between fingers and what they touch; ``None`` for the
            material's.
        squeeze: Force of each finger, N.
    """

    def __init__(
        self, task: str, *, friction: float | None = None, squeeze: float = scenes.SQUEEZE
    ) -> None:
        self.model = scenes.build(task, friction, squeeze)
        self.data = mujoco.MjData(self.model)
        self.arms = [NAME]
        self.objects = [name for name, _ in SCENES[task].free]
        self.ticks = 0
        self._kinematics = Kinematics(self.model)
        self._link = self.model.body("wrist_yaw_link").id
        self.rcm = self._kinematics.world_from_rcm
        """The remote centre of motion in the world."""
        self._at = [self.model.joint(name).qposadr[0] for name in JOINTS]
        self._dofs = [self.model.joint(name).dofadr[0] for name in JOINTS]
        self._fingers = [self.model.joint(name).qposadr[0] for name in FINGERS]
        self._finger_dofs = [self.model.joint(name).dofadr[0] for name in FINGERS]
        self._geoms = {
            name: set(np.flatnonzero(self.model.geom_bodyid == self.model.body(name).id))
            for name in (*self.objects, *(f"{name}_link" for name in FINGERS))
        }
        self._events: list[tuple[str, float, str, Any]] = []
        self._stamp = 0.0
        self._home = np.array([0.0, 0.0, 0.12, 0.0, 0.0, 0.0])
        self._controller = Controller(self._kinematics, self._home, self._tell)
        self._cables: Cables | None = None
        base = self.model.body("base")
        self._base = Pose(base.pos, base.quat)
        self._place(self._home, {})

    # ---- Episodes ----

    def begin(
        self,
        wrist: Sequence[float],
        objects: Mapping[str, Sequence[float]],
        *,
        errors: np.random.Generator | None = None,
    ) -> None:
        """Begins an episode: the arm at a pose of the world, jaws closed, objects laid at rest.

        The arm keeps its operating state and its reference frame. Objects that are not named are
        taken away.

        Args:
            wrist: Where the arm is, by its encoders.
            objects: Where objects are.
            errors: What draws the errors of a real arm, see ``cables.py``; ``None`` for none.

        Raises:
            ValueError: There is no such object, or the arm does not reach the pose.
        """
        unknown = set(objects) - set(self.objects)
        if unknown:
            raise ValueError(f"objects {sorted(unknown)}: this world has {self.objects}")
        target = self.rcm.inverse() @ Pose.of(np.array(wrist, float))
        joints = self._kinematics.inverse(target, self._home)
        reached = self._kinematics.wrist(joints)
        off = np.linalg.norm(reached.position - target.position)
        if off > 1e-6 or np.abs(reached.rotation_from(target)).max() > 1e-6:
            raise ValueError(f"wrist {list(wrist)}: not within the joints' limits, {off} m off")
        self._controller.command("hold", (), (), "")
        self._controller.set_point = np.append(joints, 0.0)
        self._cables = None if errors is None else Cables(errors, joints)
        base = self._base if errors is None else moved_base(errors, self._base)
        self.model.body("base").pos[:] = base.position
        self.model.body("base").quat[:] = base.quaternion
        self._place(joints if self._cables is None else self._cables.links(), objects)
        for _ in range(SETTLING):
            self._step()

    def _place(self, joints: Numbers, objects: Mapping[str, Sequence[float]]) -> None:
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[self._at] = joints
        for index, name in enumerate(self.objects):
            laid = Pose.of(np.array(objects.get(name, AWAY + index * APART), float))
            at = self.model.joint(name).qposadr[0]
            self.data.qpos[at : at + 7] = [*laid.position, *laid.quaternion]
        mujoco.mj_forward(self.model, self.data)

    def touches(self, name: str) -> int:
        """How many fingers press on an object."""
        pressing = set()
        for contact in self.data.contact[: self.data.ncon]:
            for finger in (f"{finger}_link" for finger in FINGERS):
                for one, other in (contact.geom, contact.geom[::-1]):
                    if one in self._geoms[finger] and other in self._geoms[name]:
                        pressing.add(finger)
        return len(pressing)

    def pressure(self, finger: str) -> float:
        """How hard all presses on a finger, ``jaw_1`` or ``jaw_2``, N; friction is not in it."""
        total, wrench = 0.0, np.empty(6)
        for index, contact in enumerate(self.data.contact[: self.data.ncon]):
            if self._geoms[f"{finger}_link"] & set(contact.geom.tolist()):
                mujoco.mj_contactForce(self.model, self.data, index, wrench)
                total += wrench[0]
        return total

    # ---- What trocar.dvrk calls ----

    def command(
        self,
        arm: str,
        topic: str,
        numbers: Sequence[float] = (),
        more: Sequence[float] = (),
        text: str = "",
    ) -> None:
        """Gives a command to the arm."""
        self._check(arm)
        self._controller.command(topic, numbers, more, text)

    def advance(self, ticks: int, until_event: bool = False) -> int:
        """Lets so many ticks pass; how many did. ``until_event`` stops after one with an event."""
        for passed in range(ticks):
            self._step()
            if until_event and self._events:
                return passed + 1
        return ticks

    def events(self) -> list[tuple[str, float, str, Any]]:
        """What the arm has told since the last call: arm, stamp, topic, value."""
        told, self._events = self._events, []
        return told

    def operating_state(self, arm: str) -> tuple[str, bool, bool]:
        """Operating state, whether it is homed, whether it is busy."""
        self._check(arm)
        return self._controller.state, self._controller.is_homed, self._controller.is_busy

    def joints(
        self, arm: str, *, setpoint: bool = False, jaw: bool = False
    ) -> tuple[Numbers, Numbers, float]:
        """Positions, velocities and stamp of the joints, or of the jaw."""
        self._check(arm)
        if setpoint:
            part = self._controller.set_point[6:] if jaw else self._controller.set_point[:6]
            return part.copy(), np.zeros(len(part)), self.now()
        if jaw:
            opening = self.data.qpos[self._fingers].sum()
            return (
                np.array([opening]),
                np.array([self.data.qvel[self._finger_dofs].sum()]),
                self.now(),
            )
        return self._measured(), self.data.qvel[self._dofs].copy(), self.now()

    def _measured(self) -> Numbers:
        """What the encoders say: they move along with what moves the links off their targets."""
        links: Numbers = self.data.qpos[self._at].copy()
        if self._cables is None:
            return links
        return self._cables.encoders[:6] + links - self._cables.links()

    def pose(self, arm: str, topic: str) -> tuple[list[float], float]:
        """A pose of the arm and its stamp: ``measured_cp``, ``setpoint_cp``, or below ``local``."""
        self._check(arm)
        if topic.endswith("setpoint_cp"):
            wrist = self._kinematics.wrist(self._controller.set_point[:6])
        else:
            wrist = self._kinematics.wrist(self._measured())
        if not topic.startswith("local/"):
            wrist = self._controller.base @ wrist
        return wrist.numbers(), self.now()

    def twist(self, arm: str) -> tuple[list[float], float]:
        """The twist of the wrist, m/s and rad/s, and its stamp."""
        self._check(arm)
        six = np.empty(6)
        kind = mujoco.mjtObj.mjOBJ_XBODY
        mujoco.mj_objectVelocity(self.model, self.data, kind, self._link, six, 0)
        return [*six[3:].tolist(), *six[:3].tolist()], self.now()

    def object(self, name: str) -> list[float]:
        """Where an object is in the world."""
        body = self.model.body(name).id
        return Pose(self.data.xpos[body], self.data.xquat[body]).numbers()

    def describe(self, arm: str) -> tuple[list[str], bool, list[float]]:
        """The arm's joints, that it has a jaw, where its remote centre is in the world."""
        self._check(arm)
        return list(JOINTS), True, self.rcm.numbers()

    def status(self, arm: str) -> tuple[float, int, str]:
        """The ratio of moves, the process that drives the arm (none), its reference frame."""
        self._check(arm)
        return 1.0, 0, "world"

    def ask(
        self, arm: str, question: str, numbers: Sequence[float] = (), more: Sequence[float] = ()
    ) -> tuple[list[float], str]:
        """A service: ``forward_kinematics`` or ``inverse_kinematics``; numbers, or none and why."""
        self._check(arm)
        base, values = self._controller.base, np.array(numbers, float)
        if question == "forward_kinematics" and len(values) == 6:
            return (base @ self._kinematics.wrist(values)).numbers(), ""
        if question == "inverse_kinematics" and len(values) == 7 and len(more) == 6:
            local = base.inverse() @ Pose.of(values)
            return self._kinematics.inverse(local, np.array(more)).tolist(), ""
        return [], f"{question}: not a question to this arm, or not its numbers"

    def close(self) -> None:
        """Nothing: the world ends with the object."""

    # ---- Time ----

    def now(self) -> float:
        """The stamp of what is measured now, s; never 0."""
        return (self.ticks + 1) * TICK

    def _step(self) -> None:
        self._controller.tick()
        links, jaw = self._controller.set_point[:6], self._controller.set_point[6]
        if self._cables is not None:
            self._cables.advance(self._controller.set_point, TICK)
            links, jaw = self._cables.links(), self._cables.encoders[6]
        self.data.ctrl[:] = [*links, jaw, 0.0]
        mujoco.mj_step(self.model, self.data, nstep=STEPS)
        mujoco.mj_kinematics(self.model, self.data)
        self.ticks += 1

    def _tell(self, topic: str, value: Any) -> None:
        # Stamps must grow, also within a tick.
        self._stamp = max(self.now(), self._stamp + 1e-6)
        self._events.append((NAME, self._stamp, topic, value))

    def _check(self, arm: str) -> None:
        if arm != NAME:
            raise ValueError(f"arm {arm!r}: this world has {NAME}")
