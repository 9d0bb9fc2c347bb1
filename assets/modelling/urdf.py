"""URDF text and mesh files of a model, with inertia computed from the visual meshes."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from .mesh import Mesh

HALF_PI = math.pi / 2

@dataclass
class Material:
    """What something is made of: colour, and density in kg/m³."""

    rgba: str
    density: float


def read_materials() -> dict[str, Material]:
    """The table of materials, which the server reads too."""
    with (Path(__file__).resolve().parents[1] / "materials.csv").open(encoding="utf-8") as table:
        rows = list(csv.reader(table))[1:]
    return {
        name: Material(f"{red} {green} {blue} 1", float(density))
        for name, red, green, blue, density, *_ in rows
    }


MATERIALS = read_materials()


@dataclass
class Visual:
    """A mesh file with one material; `origin` places it in the link."""

    name: str
    mesh: Mesh
    material: str
    origin: str = ""


@dataclass
class Collision:
    """One primitive: `geometry` is the URDF element, `origin` the attributes of its pose."""

    geometry: str
    origin: str = ""


@dataclass
class Link:
    name: str
    visuals: list[Visual] = field(default_factory=list)
    collisions: list[Collision] = field(default_factory=list)


@dataclass
class Joint:
    """`limit` holds lower, upper, effort and velocity; `mimic` the joint followed and the ratio."""

    name: str
    kind: str
    parent: str
    child: str
    origin: str
    limit: tuple[float, float, float, float] | None = None
    mimic: tuple[str, float] | None = None


def origin(xyz: tuple[float, float, float] = (0, 0, 0), rpy: str = "0 0 0") -> str:
    """Attributes of a pose: `xyz` in mm, `rpy` as written."""
    metres = " ".join(f"{x * 1e-3:.10g}" for x in xyz)
    return f'xyz="{metres}" rpy="{rpy}"'


def box(size: tuple[float, float, float], centre: tuple[float, float, float]) -> Collision:
    metres = " ".join(f"{x * 1e-3:.10g}" for x in size)
    return Collision(f'<box size="{metres}"/>', origin(centre))


def capsule(radius: float, length: float, pose: str) -> Collision:
    """A capsule along z; `length` is the distance between the centres of its end spheres."""
    size = f'radius="{radius * 1e-3:.10g}" length="{length * 1e-3:.10g}"'
    return Collision(f"<capsule {size}/>", pose)


def cylinder(radius: float, length: float) -> Collision:
    """A cylinder along z about the origin."""
    size = f'radius="{radius * 1e-3:.10g}" length="{length * 1e-3:.10g}"'
    return Collision(f"<cylinder {size}/>", origin())


@dataclass
class Model:
    """A robot or an object: its files lie in the folder of the same name.

    Meshes that are equal to those of `lender` are used from there.
    """

    name: str
    links: list[Link]
    joints: list[Joint] = field(default_factory=list)
    comment: str = ""
    lender: Model | None = None

    def files(self, urdf_name: str = "model.urdf") -> dict[str, str]:
        """Path below assets/ to text, for the URDF and every mesh of its own."""
        files = {f"{self.name}/{urdf_name}": self.urdf()}
        for visual in self.visuals():
            if not self.borrows(visual):
                path = f"{self.name}/meshes/{visual.name}.obj"
                files[path] = visual.mesh.obj(visual.name, visual.material)
        return files

    def visuals(self) -> list[Visual]:
        return [visual for link in self.links for visual in link.visuals]

    def borrows(self, visual: Visual) -> bool:
        lent = self.lender.visuals() if self.lender else []
        return any(other.name == visual.name and other.mesh == visual.mesh for other in lent)

    def mesh_path(self, visual: Visual) -> str:
        """Path of the visual's mesh from the URDF's folder."""
        folder = f"../{self.lender.name}/" if self.borrows(visual) else ""
        return f"{folder}meshes/{visual.name}.obj"

    def urdf(self) -> str:
        used = {visual.material for visual in self.visuals()}
        lines = ['<?xml version="1.0"?>', "<!-- Made by assets/generate.py. Units: m, rad, kg. -->"]
        lines += [f"<!-- {self.comment} -->"] if self.comment else []
        lines.append(f'<robot name="{self.name}">')
        for name, material in MATERIALS.items():
            if name in used:
                lines.append(f'  <material name="{name}"><color rgba="{material.rgba}"/></material>')
        for link in self.links:
            lines += link_lines(link, self.mesh_path)
        for joint in self.joints:
            lines += joint_lines(joint)
        return "\n".join(lines + ["</robot>"]) + "\n"


def link_lines(link: Link, mesh_path: Callable[[Visual], str]) -> list[str]:
    if not link.visuals and not link.collisions:
        return [f'  <link name="{link.name}"/>']
    lines = [f'  <link name="{link.name}">']
    if link.visuals:
        lines += inertial_lines(link)
    for visual in link.visuals:
        lines.append("    <visual>")
        lines += [f"      <origin {visual.origin}/>"] if visual.origin else []
        lines.append(f'      <geometry><mesh filename="{mesh_path(visual)}"/></geometry>')
        lines.append(
            f'      <material name="{visual.material}"><color rgba="'
            f'{MATERIALS[visual.material].rgba}"/></material>'
        )
        lines.append("    </visual>")
    for collision in link.collisions:
        lines.append("    <collision>")
        lines += [f"      <origin {collision.origin}/>"] if collision.origin else []
        lines.append(f"      <geometry>{collision.geometry}</geometry>")
        lines.append("    </collision>")
    return lines + ["  </link>"]


def inertial_lines(link: Link) -> list[str]:
    """Sum of the visual meshes' mass properties, each with its material's density."""
    mass, first = 0.0, [0.0] * 3
    second = [[0.0] * 3 for _ in range(3)]
    for visual in link.visuals:
        assert visual.origin in ("", FLIPPED), "inertia handles the half turn about y only"
        m, centre, moments = visual.mesh.mass_properties(MATERIALS[visual.material].density)
        sign = (-1, 1, -1) if visual.origin == FLIPPED else (1, 1, 1)
        mass += m
        for i in range(3):
            first[i] += m * centre[i] * sign[i]
            for j in range(3):
                second[i][j] += moments[i][j] * sign[i] * sign[j]
    centre = [x / mass for x in first]
    about = [[second[i][j] - mass * centre[i] * centre[j] for j in range(3)] for i in range(3)]
    trace = about[0][0] + about[1][1] + about[2][2]
    inertia = {
        f"i{'xyz'[i]}{'xyz'[j]}": (trace if i == j else 0.0) - about[i][j]
        for i in range(3)
        for j in range(i, 3)
    }
    # Products of inertia that vanish by symmetry come out as rounding noise.
    inertia = {n: v if abs(v) > 1e-9 * trace else 0.0 for n, v in inertia.items()}
    centre = [c if abs(c) > 1e-9 else 0.0 for c in centre]
    tensor = " ".join(f'{n}="{v:.6g}"' for n, v in inertia.items())
    return [
        "    <inertial>",
        f'      <origin xyz="{" ".join(f"{c:.6g}" for c in centre)}" rpy="0 0 0"/>',
        f'      <mass value="{mass:.6g}"/>',
        f"      <inertia {tensor}/>",
        "    </inertial>",
    ]


def joint_lines(joint: Joint) -> list[str]:
    lines = [
        f'  <joint name="{joint.name}" type="{joint.kind}">',
        f'    <parent link="{joint.parent}"/>',
        f'    <child link="{joint.child}"/>',
        f"    <origin {joint.origin}/>",
    ]
    if joint.kind != "fixed":
        lower, upper, effort, velocity = joint.limit
        lines.append('    <axis xyz="0 0 1"/>')
        lines.append(
            f'    <limit lower="{lower!r}" upper="{upper!r}" '
            f'effort="{effort!r}" velocity="{velocity!r}"/>'
        )
    if joint.mimic:
        lines.append(f'    <mimic joint="{joint.mimic[0]}" multiplier="{joint.mimic[1]:g}"/>')
    return lines + ["  </joint>"]


# A half turn about y: how the second jaw is made from the first.
FLIPPED = origin(rpy=f"0 {math.pi} 0")
