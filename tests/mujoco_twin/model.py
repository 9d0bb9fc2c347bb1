"""The scenes of the tasks as MuJoCo models, made from the URDFs of ``assets``.

Geometry, masses and inertias are the project's; what comes from its sources has their names beside
it, below ``server/src``. The world's frame is the tasks' *scene* frame: z up, the table's top at
0.675 m.
"""

from __future__ import annotations

import csv
import functools
import itertools
import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from mujoco_twin import contact

Numbers = NDArray[np.float64]

ASSETS = Path(__file__).resolve().parents[2] / "assets"

JOINTS = ("yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw")
FINGERS = ("jaw_1", "jaw_2")

BASE = ((0.05, 0.24, 0.8524), math.radians(-110.0))
"""Base of PSM1: position, m, and turn about the vertical (``tasks/psm_scene.rs``, ``BASES``)."""

BASE_FROM_RCM = (0.0, 0.4864, 0.0)
"""The remote centre of motion in the base, m (``tasks/psm_scene.rs``)."""

TIP_OFFSET = 0.0102
"""From the wrist to the tip of the closed jaws, m (dVRK; ``robots/psm.rs``)."""

SQUEEZE = 1.0
"""Force with which each finger squeezes, N (``tasks/psm_scene.rs``)."""

LEVER = TIP_OFFSET - 1e-3
"""From the hinge to where the jaws grip, m (``sim/instrument.rs``)."""

ASIDE = 2.0
"""Torque that keeps fingers about the middle, over that of the squeeze (``sim/instrument.rs``)."""

FINGER_INERTIA = 0.02 * TIP_OFFSET**2 / 3.0
"""Inertia of a finger's drive about its hinge, kg·m²: of a rod of 20 g (``sim/instrument.rs``)."""

JAW = (0.0, 1.39626)
"""Least and greatest opening of the jaws, rad: closed fingers stop each other (dVRK)."""

FINGER = (-0.5, 0.8)
"""Where the turning of a finger ends, rad: 0 is the middle of the wrist (``sim/instrument.rs``)."""

ARMATURE = (0.02, 0.02, 0.1, 1e-4, 1e-4, 1e-4)
"""Inertia of the drives at the joints, kg·m²; index 2 in kg. An assumption of ours.

It is more than that of the instrument's links, so that the servos hardly depend on the pose.
"""

SERVO = 200.0
"""Natural frequency of the joints' servos, rad/s. An assumption of ours.

They are critically damped, so links lag by 2 / SERVO = 10 ms. Real arms lag by 15 to 54 ms.
"""

JAW_SERVO = 1000.0
"""That of the jaw, rad/s: it gives its whole torque from 13 mrad on."""

TABLE = (0.5, 0.0, 0.001)
TRAY_WITH_PAD = (0.55, 0.0, 0.6751)
TRAY_WITH_GAUZE = (0.55, 0.0, 0.6781)
BOARD = (0.55, 0.0, 0.6861)
"""Origins of what does not move, m (``tasks/tray.rs``, ``gauze.rs``, ``peg_board.rs``)."""

ARM, THINGS, COARSE, ARC = 2, 1, 4, 8
"""Bits of the collision filter: the arm, other things, a needle for these, a needle for the arm."""

PIECES = 48
"""Pieces of a needle's arc where fingers meet it: bent by less than 4° from one to the next.

The eight of its URDF are bent by 22° in the middle of the arc, where needles are grasped. There
they keep jaws apart by 0.17 mm more than a wire that is bent evenly.
"""


@dataclass(frozen=True)
class Scene:
    """What stands and lies on the table."""

    static: tuple[tuple[str, tuple[float, float, float]], ...]
    """Models that do not move, and their origins, m."""
    free: tuple[tuple[str, str], ...]
    """Names of free objects, and their models."""


SCENES = {
    "NeedlePick-v0": Scene(
        (("tray", TRAY_WITH_PAD), ("pad", TRAY_WITH_PAD)), (("needle", "needle"),)
    ),
    "GauzeRetrieve-v0": Scene((("tray", TRAY_WITH_GAUZE),), (("gauze", "gauze"),)),
    "PegTransfer-v0": Scene(
        (("pegboard", BOARD),),
        (("block", "block"), *((f"other block {n}", "block") for n in (1, 2, 3))),
    ),
}
"""Scenes by the id of the task."""


@functools.cache
def urdf(name: str) -> ET.Element:
    """The URDF of a model."""
    return ET.parse(ASSETS / name / "model.urdf").getroot()


@functools.cache
def friction_of(name: str) -> float:
    """Coefficient of friction of what a model is made of (``assets/materials.csv``)."""
    material = find(urdf(name), "link/visual/material").get("name")
    with (ASSETS / "materials.csv").open() as file:
        return next(
            float(row["friction"]) for row in csv.DictReader(file) if row["name"] == material
        )


def find(element: ET.Element, path: str) -> ET.Element:
    """The first element below another, which must be there."""
    found = element.find(path)
    if found is None:
        raise ValueError(f"{element.tag} has no {path}")
    return found


def numbers(text: str | None) -> Numbers:
    """Numbers that stand beside each other."""
    return np.array([float(word) for word in (text or "0 0 0").split()])


def words(values: object) -> str:
    """The same the other way."""
    return " ".join(f"{value:.17g}" for value in np.ravel(np.asarray(values, float)))


def quaternion(rpy: Numbers) -> Numbers:
    """The quaternion w, x, y, z of extrinsic XYZ Euler angles (rad)."""
    quat = np.empty(4)
    mujoco.mju_euler2Quat(quat, rpy, "XYZ")
    return quat


def add(parent: ET.Element, tag: str, **attributes: Any) -> ET.Element:
    """A new element of a model; attributes may be numbers."""
    written = {
        key: value if isinstance(value, str) else words(value) for key, value in attributes.items()
    }
    return ET.SubElement(parent, tag, written)


def pose(origin: ET.Element | None) -> dict[str, Numbers]:
    """``pos`` and ``quat`` of an origin."""
    xyz, rpy = (numbers(None if origin is None else origin.get(key)) for key in ("xyz", "rpy"))
    return {"pos": xyz, "quat": quaternion(rpy)}


def add_inertial(link: ET.Element, body: ET.Element) -> None:
    """Gives a body the mass, the centre of mass and the inertia of a link."""
    of = find(link, "inertial")
    tensor, mass = find(of, "inertia"), find(of, "mass")
    full = " ".join(tensor.get(key) or "0" for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"))
    centre = numbers(find(of, "origin").get("xyz"))
    add(body, "inertial", mass=mass.get("value"), pos=centre, fullinertia=full)


def add_shapes(
    link: ET.Element, body: ET.Element, friction: float, torsion: float = 0.0, **attributes: Any
) -> None:
    """Gives a body the collision shapes of a link, with coefficients of friction: 1, and m."""
    for collision in link.findall("collision"):
        shape = find(collision, "geometry")[0]
        if shape.tag == "box":
            size = numbers(shape.get("size")) / 2.0
        elif shape.tag == "capsule":
            size = numbers(f"{shape.get('radius')} {shape.get('length')}") * [1.0, 0.5]
        else:
            raise ValueError(f"collision shapes are boxes and capsules, not {shape.tag}")
        place = pose(collision.find("origin"))
        only = {"friction": (friction, torsion, 0.0), **attributes}
        add(body, "geom", type=shape.tag, size=size, **place, **only)


def build(task: str, friction: float | None = None, squeeze: float = SQUEEZE) -> mujoco.MjModel:
    """The model of a task's scene.

    Args:
        task: Id of the task.
        friction: Coefficient of friction between fingers and what they touch; ``None`` for
            :data:`contact.FINGER_FRICTION`.
        squeeze: Force of each finger, N.

    Raises:
        ValueError: There is no such scene, or a number is not above 0.
    """
    if task not in SCENES:
        raise ValueError(f"task {task!r}: allowed are {', '.join(SCENES)}")
    for name, value in (("friction", friction), ("squeeze", squeeze)):
        if value is not None and not 0.0 < value < math.inf:
            raise ValueError(f"{name} {value!r}: allowed are numbers above 0")
    root = ET.Element("mujoco")
    add(root, "compiler", angle="radian", autolimits="true")
    add(
        root,
        "option",
        timestep=contact.TIMESTEP,
        gravity=(0.0, 0.0, -contact.GRAVITY),
        integrator=contact.INTEGRATOR,
        solver=contact.SOLVER,
        iterations=contact.ITERATIONS,
        tolerance=contact.TOLERANCE,
        cone=contact.CONE,
        impratio=contact.IMPRATIO,
        noslip_iterations=contact.NOSLIP_ITERATIONS,
    )
    geom = {"condim": contact.CONDIM, "solref": contact.SOLREF, "solimp": contact.SOLIMP}
    add(add(root, "default"), "geom", **geom)
    world = add(root, "worldbody")
    scene = SCENES[task]
    things = {"contype": THINGS, "conaffinity": THINGS | ARM | COARSE}
    for name, origin in (("table", TABLE), *scene.static):
        body = add(world, "body", name=name, pos=origin)
        add_shapes(find(urdf(name), "link"), body, friction_of(name), **things)
    for name, of in scene.free:
        body = add(world, "body", name=name)
        add(body, "freejoint", name=name)
        add_inertial(find(urdf(of), "link"), body)
        if of == "needle":
            coarse = {"contype": COARSE, "conaffinity": COARSE}
            add_shapes(find(urdf(of), "link"), body, friction_of(of), **coarse)
            add_arc(body, friction_of(of))
        else:
            add_shapes(find(urdf(of), "link"), body, friction_of(of), **things)
    fingers = contact.FINGER_FRICTION if friction is None else friction
    add_arm(root, world, fingers, squeeze * LEVER)
    model = mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
    tune(model)
    return model


def add_arc(body: ET.Element, friction: float) -> None:
    """Gives a needle the shapes that fingers meet: its wire, bent evenly from end to end."""
    mid_arc = next(j for j in urdf("needle").findall("joint") if j.get("name") == "mid_arc_frame")
    radius = -numbers(find(mid_arc, "origin").get("xyz"))[0]
    segments = urdf("needle").findall("link/collision")
    wire = float(find(segments[0], "geometry/capsule").get("radius") or 0)
    length = float(find(segments[0], "geometry/capsule").get("length") or 0)
    half = len(segments) * math.asin(0.5 * length / radius)
    angles = math.pi + np.linspace(-half, half, PIECES + 1)
    ends = radius * np.array([np.cos(angles), np.sin(angles), 0.0 * angles]).T
    met = {"contype": ARC, "conaffinity": ARM, "friction": (friction, 0.0, 0.0)}
    for one, other in itertools.pairwise(ends):
        add(body, "geom", type="capsule", size=wire, fromto=np.append(one, other), **met)


def add_arm(root: ET.Element, world: ET.Element, friction: float, torque: float) -> None:
    """Puts PSM1 into a model: links, servos, and fingers whose drive has a limited torque (N·m)."""
    position, turn = BASE
    base = add(world, "body", name="base", pos=position, quat=quaternion(np.array([0, 0, turn])))
    parent = add(base, "body", name="rcm", pos=BASE_FROM_RCM)
    joints = {joint.get("name"): joint for joint in urdf("psm").findall("joint")}
    links = {link.get("name"): link for link in urdf("psm").findall("link")}
    actuators, tendons = add(root, "actuator"), add(root, "tendon")
    filtered = {"contype": ARM, "conaffinity": THINGS}

    def body(name: str) -> ET.Element:
        place = pose(joints[name].find("origin"))
        made = add(parent, "body", name=f"{name}_link", gravcomp="1", **place)
        add_inertial(links[f"{name}_link"], made)
        return made

    for name, armature in zip(JOINTS, ARMATURE, strict=True):
        limit = find(joints[name], "limit")
        span, effort = f"{limit.get('lower')} {limit.get('upper')}", float(limit.get("effort") or 0)
        kind = "slide" if joints[name].get("type") == "prismatic" else "hinge"
        parent = body(name)
        add(parent, "joint", name=name, type=kind, axis="0 0 1", range=span, armature=armature)
        add_shapes(links[f"{name}_link"], parent, contact.FINGER_FRICTION, **filtered)
        add(actuators, "position", name=name, joint=name, forcerange=(-effort, effort))
    opening = add(tendons, "fixed", name="opening", range=JAW)
    aside = add(tendons, "fixed", name="aside")
    for name, sign in zip(FINGERS, (1, -1), strict=True):
        finger = body(name)
        # Positive where the finger opens.
        turns = {"axis": (0, 0, sign), "range": FINGER, "armature": FINGER_INERTIA}
        add(finger, "joint", name=name, **turns)
        # Its coefficients count, whatever it touches.
        own = {"priority": 1, "condim": contact.FINGER_CONDIM}
        torsion = friction * contact.FINGER_TORSION
        add_shapes(links[f"{name}_link"], finger, friction, torsion, **own, **filtered)
        add(opening, "joint", joint=name, coef="1")
        add(aside, "joint", joint=name, coef=sign)
    for name, most in (("opening", torque), ("aside", ASIDE * torque)):
        add(actuators, "position", name=name, tendon=name, forcerange=(-most, most))


def tune(model: mujoco.MjModel) -> None:
    """Sets the servos: of the frequencies above, critically damped, for the inertia at home."""
    data = mujoco.MjData(model)
    data.joint("insertion").qpos[:] = 0.12
    mujoco.mj_forward(model, data)
    mass = np.empty((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    inertias = [mass[dof, dof] for dof in (model.joint(name).dofadr[0] for name in JOINTS)]
    # Both fingers turn by half of what the tendon does.
    finger = mass[model.joint("jaw_1").dofadr[0], model.joint("jaw_1").dofadr[0]]
    rows = [(name, inertia, SERVO) for name, inertia in zip(JOINTS, inertias, strict=True)]
    rows += [(name, finger / 2.0, JAW_SERVO) for name in ("opening", "aside")]
    for name, inertia, frequency in rows:
        actuator = model.actuator(name)
        actuator.gainprm[0] = inertia * frequency**2
        actuator.biasprm[1:3] = -inertia * frequency**2, -2.0 * inertia * frequency
