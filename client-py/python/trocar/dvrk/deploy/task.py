"""What a runner has to know of a task, asked of the task itself: nothing here is a copy.

The specification names the elements of actions and observations, with frames. What it does not tell
is measured in a live world: where places are on objects, how low jaws may go, where arms stand.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from trocar import _trocar
from trocar._connection import connect
from trocar.dvrk.deploy.geometry import Numbers, Pose, of_euler_xyz
from trocar.errors import TrocarError, Unsupported

TICKS = 240
"""Ticks in a second of a live world."""

TRIES = 3
"""Episodes in which it is tried how far arms go: in one of them no object is in their way."""

EULER = ("roll", "pitch", "yaw")

AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Task:
    """A task as a runner sees it."""

    spec: _trocar.TaskSpec
    """Its elements, its goals and its length."""
    options: Mapping[str, Any]
    """The options that were given."""
    arms: tuple[str, ...]
    """The arms that its actions move, in the order of their numbers."""
    bases: Mapping[str, Pose]
    """Where the remote centre of each arm is, in the scene."""
    objects: tuple[str, ...]
    """Its objects, by the names of their topics."""
    places: Mapping[str, tuple[str, Pose]]
    """Places on objects: the object, and where the place is in its frame."""
    boxes: Mapping[str, Numbers]
    """Where the wrist of each PSM may go, in the scene, m: lower corner, then upper one."""
    lowest: Mapping[str, float]
    """The lowest height of the tip of each PSM's jaws, which point down, in the scene, m."""
    starts: Mapping[str, Pose]
    """Where episodes begin: the wrist of each PSM, in the scene."""
    reference: Pose
    """The ECM's camera with all joints at 0, in the frame of its remote centre."""

    @classmethod
    def open(cls, task: str, *, server: str | None = None, **options: Any) -> Task:
        """Asks a server about a task.

        Args:
            task: Id without namespace, e.g. ``NeedlePick-v0``.
            server: Name of the server; ``None`` for ``$TROCAR_SERVER``, else a private one.
            options: The task's options.

        Raises:
            ValueError: An option is not allowed.
            trocar.errors.Unsupported: A robot cannot do what the task asks for.
        """
        world = connect(server).open_live(task, options=options, homing="in_place")
        try:
            return _described(world, options)
        finally:
            world.close()

    def with_floor(self, height: float) -> Task:
        """The same, where tips may go down to a height, m, scene frame."""
        return replace(self, lowest=dict.fromkeys(self.lowest, height))

    @property
    def numbers(self) -> int:
        """How many numbers of an action each arm has."""
        return len(self.spec.action) // len(self.arms)

    @property
    def moves_camera(self) -> bool:
        """Whether it is the endoscope that moves."""
        return self.arms == ("ECM",)


def split(name: str) -> tuple[str, str]:
    """A name of an element: what it is of, and the axis or angle, which is empty for others."""
    what, _, last = name.rpartition(" ")
    return (what, last) if last in (*AXES, *EULER) else (name, "")


def _described(world: Any, options: Mapping[str, Any]) -> Task:
    spec = world.spec
    arms = tuple(arm for arm in world.arms if arm != "ECM") or ("ECM",)
    bases = {arm: Pose.of_numbers(world.describe(arm)[2]) for arm in world.arms}
    zeros, why = world.ask("ECM", "local/forward_kinematics", [0.0] * 4)
    if why:
        raise TrocarError(f"ECM, local/forward_kinematics: {why}")
    places = _places(world)
    psms = [arm for arm in arms if arm != "ECM"]
    starts = {
        arm: bases[arm] @ Pose.of_numbers(world.pose(arm, "local/measured_cp")[0]) for arm in psms
    }
    reach = {} if arms == ("ECM",) else _reach(world, arms)
    return Task(
        spec=spec,
        options=dict(options),
        arms=arms,
        bases=bases,
        objects=tuple(name.replace(" ", "_") for name in world.objects),
        places=places,
        boxes={arm: box for arm, (box, _) in reach.items()},
        lowest={arm: lowest for arm, (_, lowest) in reach.items()},
        starts=starts,
        reference=Pose.of_numbers(zeros),
    )


def _places(world: Any) -> dict[str, tuple[str, Pose]]:
    """Places of which the state has position and angles, in the frame of the task's only object.

    Of several objects, a task observes the first one.
    """
    if not world.objects:
        return {}
    names = [element.name for element in world.spec.observation]
    observation, *_ = world.observation()
    numbers = dict(zip(names, observation.tolist(), strict=True))
    body = world.objects[0]
    scene_from_body = Pose.of_numbers(world.object(body))
    found = {}
    for what in dict.fromkeys(split(name)[0] for name in names):
        if f"{what} x" not in numbers or f"{what} roll" not in numbers or "wrist" in what:
            continue
        position = np.array([numbers[f"{what} {axis}"] for axis in AXES])
        rotation = of_euler_xyz([numbers[f"{what} {angle}"] for angle in EULER])
        place = scene_from_body.inverse() @ Pose(rotation, position)
        found[what] = (body.replace(" ", "_"), place)
    return found


def _reach(world: Any, arms: tuple[str, ...]) -> dict[str, tuple[Numbers, float]]:
    """The box of each arm's wrist, and the lowest height of its tip, m.

    Each arm goes along every axis by the task's own actions until they lead no farther. Downwards
    that is where jaws that point down end; how far a tilted wrist goes is told by the range of the
    state, which is as much larger than the box on all sides.
    """
    spec = world.spec
    if not spec.action[2].name.endswith("dz"):
        return {}
    bounds = {element.name: element for element in spec.observation}
    reach = {}
    for arm in arms:
        prefix = "" if len(arms) == 1 else f"{arm} "
        x, z = (bounds.get(f"{prefix}wrist {axis}") for axis in "xz")
        if x is None or z is None or x.unit != "m":
            raise Unsupported(
                f"{spec.id}: its state has no `{prefix}wrist x` in m; allowed are options with the "
                "state in metres"
            )
        # Of wrist and tip, both of which are confined in x and y, the one that is farther.
        low = [_end(world, arm, axis, -1.0).min(axis=0)[axis] for axis in range(2)]
        high = [_end(world, arm, axis, 1.0).max(axis=0)[axis] for axis in range(2)]
        top, bottom = _end(world, arm, 2, 1.0)[0, 2], _end(world, arm, 2, -1.0)[1, 2]
        box = np.array([[*low, z.min + low[0] - x.min], [*high, top]])
        reach[arm] = (box, float(bottom))
    return reach


def _end(world: Any, arm: str, axis: int, way: float) -> Numbers:
    """Wrist and tip, shape (2, 3), m, where an arm goes no farther along an axis of the scene."""
    numbers = len(world.spec.action) // sum(name != "ECM" for name in world.arms)
    action = [0.0] * (numbers - 1) + [-1.0]
    action[axis] = way
    scene_from_base = Pose.of_numbers(world.describe(arm)[2])
    found = []
    for seed in range(TRIES):
        world.reset(seed)
        for word in ("enable", "home"):
            world.command(arm, "state_command", text=word)
        world.advance(TICKS)
        before = -np.inf
        while True:
            goal, why = world.ask(arm, "task/set_point", action)
            if why:
                raise TrocarError(f"{arm}, task/set_point: {why}")
            wrist = scene_from_base @ Pose.of_numbers(goal[:7])
            now = way * float(wrist.position[axis])
            if now - before < 1e-6:
                break
            before = now
            world.command(arm, "servo_cp", goal[:3], goal[3:7])
            world.advance(TICKS // 4)
        found.append(np.array([wrist.position, wrist.position + wrist.rotation @ TIP]))
    return max(found, key=lambda ends: way * ends[0, axis])


TIP = np.array([0.0, 0.0, 0.0102])
"""The tip of closed jaws in the frame of ``measured_cp``, m. Source: the kinematics of dVRK's
Large Needle Driver; docs/dvrk.md shows it."""
