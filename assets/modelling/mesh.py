"""Closed triangle meshes made by lofting rings of points.

Every shape is a loft: a list of rings with equally many points (or one point, an apex), joined by
a skin and closed at both ends. Rings run counter-clockwise seen from the end of the loft, so that
all faces look outwards.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

Point = tuple[float, float, float]

# Faces that meet at a larger angle than this keep a sharp edge between them.
CREASE = math.radians(38.0)


def add(a: Point, b: Point) -> Point:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def sub(a: Point, b: Point) -> Point:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def scale(a: Point, s: float) -> Point:
    return (a[0] * s, a[1] * s, a[2] * s)


def dot(a: Point, b: Point) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Point, b: Point) -> Point:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def unit(a: Point) -> Point:
    return scale(a, 1.0 / math.sqrt(dot(a, a)))


@dataclass
class Mesh:
    """A closed surface: vertices in mm and triangles, counter-clockwise from outside."""

    vertices: list[Point] = field(default_factory=list)
    triangles: list[tuple[int, int, int]] = field(default_factory=list)

    def __add__(self, other: Mesh) -> Mesh:
        n = len(self.vertices)
        moved = [(a + n, b + n, c + n) for a, b, c in other.triangles]
        return Mesh(self.vertices + other.vertices, self.triangles + moved)

    def moved(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Mesh:
        return Mesh([add(v, (x, y, z)) for v in self.vertices], self.triangles)

    def axes(self, x: Point, y: Point, z: Point) -> Mesh:
        """The mesh with its axes turned onto the given right-handed unit vectors."""
        turned = [add(add(scale(x, a), scale(y, b)), scale(z, c)) for a, b, c in self.vertices]
        return Mesh(turned, self.triangles)

    def along_x(self) -> Mesh:
        """The mesh with its z axis laid along x (x → y, y → z)."""
        return self.axes((0, 1, 0), (0, 0, 1), (1, 0, 0))

    def along_y(self) -> Mesh:
        """The mesh with its z axis laid along y (x → z, y → x)."""
        return self.axes((0, 0, 1), (1, 0, 0), (0, 1, 0))

    def face(self, triangle: tuple[int, int, int]) -> tuple[Point, Point, Point]:
        a, b, c = triangle
        return self.vertices[a], self.vertices[b], self.vertices[c]

    def corner_normals(self) -> list[tuple[Point, Point, Point]]:
        """Unit normals of each triangle's corners: smooth, but sharp across creases.

        Faces count by their area, so that a large flat face stays flat beside its bevel.
        """
        areas, faces, around = [], [], [[] for _ in self.vertices]
        for index, triangle in enumerate(self.triangles):
            a, b, c = self.face(triangle)
            areas.append(cross(sub(b, a), sub(c, a)))
            faces.append(unit(areas[index]))
            for vertex in triangle:
                around[vertex].append(index)
        limit = math.cos(CREASE)

        def normal(vertex: int, face: Point) -> Point:
            total = (0.0, 0.0, 0.0)
            for index in around[vertex]:
                if dot(faces[index], face) > limit:
                    total = add(total, areas[index])
            return unit(total)

        return [tuple(normal(v, faces[i]) for v in t) for i, t in enumerate(self.triangles)]

    def mass_properties(self, density: float) -> tuple[float, Point, list[list[float]]]:
        """Mass (kg), centre of mass (m), second moments ∫ρ·xᵢ·xⱼ dV about the origin (kg·m²).

        Each face spans a tetrahedron with the origin; their signed sums are exact for a polyhedron.
        `density` is in kg/m³.
        """
        mass, first = 0.0, (0.0, 0.0, 0.0)
        second = [[0.0] * 3 for _ in range(3)]
        for triangle in self.triangles:
            corners = [scale(p, 1e-3) for p in self.face(triangle)]
            a, b, c = corners
            tetrahedron = density * dot(a, cross(b, c)) / 6.0
            total = add(add(a, b), c)
            mass += tetrahedron
            first = add(first, scale(total, tetrahedron / 4.0))
            for i in range(3):
                for j in range(3):
                    squares = sum(p[i] * p[j] for p in corners)
                    second[i][j] += tetrahedron * (squares + total[i] * total[j]) / 20.0
        return mass, scale(first, 1.0 / mass), second

    def obj(self, name: str, material: str) -> str:
        """Wavefront OBJ text in m with five significant digits."""
        lines = ["# Made by assets/generate.py. Unit: m.", f"o {name}", f"usemtl {material}"]
        for vertex in self.vertices:
            lines.append("v " + " ".join(number(x * 1e-3) for x in vertex))
        normals: dict[str, int] = {}
        faces = []
        for triangle, corners in zip(self.triangles, self.corner_normals(), strict=True):
            parts = []
            for vertex, normal in zip(triangle, corners, strict=True):
                text = " ".join(number(round(x, 4)) for x in normal)
                parts.append(f"{vertex + 1}//{normals.setdefault(text, len(normals) + 1)}")
            faces.append("f " + " ".join(parts))
        lines += [f"vn {text}" for text in normals]
        return "\n".join(lines + faces) + "\n"


def number(x: float) -> str:
    """Five significant digits; rounding noise is zero."""
    return f"{x:.5g}" if abs(x) > 1e-9 else "0"


def loft(rings: list[list[Point]], closed: bool = False) -> Mesh:
    """The skin over `rings`, with flat ends; `closed` joins the last ring to the first instead."""
    mesh = Mesh()
    starts = []
    for ring in rings:
        starts.append((len(mesh.vertices), len(ring)))
        mesh.vertices += ring
    pairs = list(zip(starts, starts[1:] + starts[:1], strict=True))
    for (a, na), (b, nb) in pairs if closed else pairs[:-1]:
        for j in range(max(na, nb)):
            a0, a1 = a + j % na, a + (j + 1) % na
            b0, b1 = b + j % nb, b + (j + 1) % nb
            if na > 1:
                mesh.triangles.append((a0, a1, b1))
            if nb > 1:
                mesh.triangles.append((a0, b1, b0))
    if not closed:
        for (start, n), flip in ((starts[0], True), (starts[-1], False)):
            if n > 1:
                centre = len(mesh.vertices)
                ring = mesh.vertices[start : start + n]
                mesh.vertices.append(
                    scale(
                        (sum(p[0] for p in ring), sum(p[1] for p in ring), sum(p[2] for p in ring)),
                        1.0 / n,
                    )
                )
                for j in range(n):
                    p, q = start + j, start + (j + 1) % n
                    mesh.triangles.append((centre, q, p) if flip else (centre, p, q))
    return mesh


def circle(radius: float, z: float, segments: int) -> list[Point]:
    """A ring about the z axis; a single point for radius 0."""
    if radius == 0.0:
        return [(0.0, 0.0, z)]
    turn = 2.0 * math.pi / segments
    return [(radius * math.cos(turn * i), radius * math.sin(turn * i), z) for i in range(segments)]


def lathe(profile: list[tuple[float, float]], segments: int = 48, closed: bool = False) -> Mesh:
    """A surface of revolution about z through (radius, z) points, listed with rising z outside."""
    return loft([circle(r, z, segments) for r, z in profile], closed)


def rod(radius: float, z0: float, z1: float, bevel: float, segments: int = 48) -> Mesh:
    """A cylinder along z with bevelled rims."""
    inner = radius - bevel
    return lathe([(inner, z0), (radius, z0 + bevel), (radius, z1 - bevel), (inner, z1)], segments)


def tube(outer: float, inner: float, z0: float, z1: float, segments: int = 48) -> Mesh:
    """An open pipe along z."""
    return lathe([(inner, z0), (outer, z0), (outer, z1), (inner, z1)], segments, closed=True)


def rounded_rectangle(
    width: float, depth: float, radius: float, corner: int = 6
) -> list[tuple[float, float]]:
    """Outline (x, y) about the origin with round corners, counter-clockwise."""
    x, y = width / 2.0 - radius, depth / 2.0 - radius
    outline = []
    for quarter, (cx, cy) in enumerate(((x, y), (-x, y), (-x, -y), (x, -y))):
        for i in range(corner + 1):
            angle = math.pi / 2.0 * (quarter + i / corner)
            outline.append((cx + radius * math.cos(angle), cy + radius * math.sin(angle)))
    return outline


def slab(
    width: float, depth: float, z0: float, z1: float, radius: float, bevel: float, corner: int = 6
) -> Mesh:
    """A block with round vertical edges (`radius`) and bevelled rims; `radius` exceeds `bevel`."""

    def ring(inset: float, z: float) -> list[Point]:
        flat = rounded_rectangle(width - 2 * inset, depth - 2 * inset, radius - inset, corner)
        return [(x, y, z) for x, y in flat]

    # Two steps approximate a round edge.
    soft = bevel * (1.0 - math.sqrt(0.5))
    return loft(
        [
            ring(bevel, z0),
            ring(soft, z0 + soft),
            ring(0.0, z0 + bevel),
            ring(0.0, z1 - bevel),
            ring(soft, z1 - soft),
            ring(bevel, z1),
        ]
    )


def bar(length: float, width: float, z0: float, z1: float, bevel: float, corner: int = 12) -> Mesh:
    """A flat link from the origin to (length, 0) with round ends about both points."""
    block = slab(length + width, width, z0, z1, width / 2.0 - 1e-4 * width, bevel, corner)
    return block.moved(x=length / 2.0)
