"""Cubes of the tracking tasks."""

from __future__ import annotations

from .mesh import slab
from .urdf import Link, Model, Visual, box

EDGES = {"model.urdf": 100.0, "small.urdf": 80.0}  # mm, by URDF
BEVEL = 2.0
ROUND = 4.0  # of the upright edges


def cube(urdf_name: str) -> Model:
    """A cube of foam that stands on its underside; its colour is each task's."""
    edge = EDGES[urdf_name]
    mesh = slab(edge, edge, -edge / 2, edge / 2, ROUND, BEVEL)
    visual = Visual(f"cube_{edge:.0f}", mesh, "foam")
    link = Link("cube", [visual], [box((edge, edge, edge), (0, 0, 0))])
    return Model("cube", [link], comment="Origin: the centre.")
