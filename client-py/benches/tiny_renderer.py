"""Time of a picture: Trocar's renderer against PyBullet's TinyRenderer, on one scene, in turns.

`make bench-tiny-renderer` builds what this needs and runs it. An environment is stepped by its
scripted expert into the middle of an episode. Its meshes, where they are then, are given to
PyBullet as visual shapes without collision, with the same camera and a lamp in the same direction.
Both then draw colour, depth and bodies with the shadows of that one lamp, on one thread:

* ``trocar``: ``trocar_draw`` of the C library ``server/examples/in_process.rs``, which puts the
  scene together anew each time, as for an observation;
* ``tiny``: ``pybullet.getCameraImage(..., renderer=ER_TINY_RENDERER, shadow=1)`` of a client in
  this process.

Both give NumPy's arrays. On how many pixels both show the same body, and how far apart their depths
are there, is printed too.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import statistics
import sys
import time
from typing import Any, NamedTuple

import numpy as np
import pybullet

LENSES = ("endoscope", "overview")
"""Their numbers are those of the library."""

SIZES = ((128, 128), (256, 256), (640, 480))
"""Widths and heights, pixels."""


class Camera(ctypes.Structure):
    """A camera as the library tells of it, in OpenCV's convention."""

    _fields_ = [
        ("camera_from_world", ctypes.c_double * 12),
        ("intrinsics", ctypes.c_double * 4),
        ("near", ctypes.c_double),
        ("far", ctypes.c_double),
        ("towards_lamp", ctypes.c_double * 3),
    ]


class Mesh(NamedTuple):
    """A part of what there is to see."""

    body: int
    vertices: np.ndarray  # (n, 3), m, in the world
    triangles: np.ndarray  # (m, 3)
    colour: np.ndarray  # (3,), in 0 to 1


class Picture(NamedTuple):
    """What was drawn."""

    rgb: np.ndarray
    depth: np.ndarray  # m
    mask: np.ndarray  # 0 for nothing


class Trocar:
    """An environment of the library, some steps into the expert's episode."""

    def __init__(self, library: str, task: str, seed: int, steps: int) -> None:
        """Loads the library and steps."""
        self._library = ctypes.CDLL(library)
        self._library.trocar_make.restype = ctypes.c_void_p
        made = self._library.trocar_make(task.encode())
        if made is None:
            raise ValueError(f"no task {task}")
        self._env = ctypes.c_void_p(made)
        self._library.trocar_follow_expert(self._env, ctypes.c_uint64(seed), ctypes.c_uint32(steps))

    def meshes(self) -> list[Mesh]:
        """All that there is to see."""
        meshes = []
        for index in range(self._library.trocar_meshes(self._env)):
            sizes = (ctypes.c_uint32 * 3)()
            self._library.trocar_mesh_sizes(self._env, index, sizes)
            body, vertices, triangles = sizes
            mesh = Mesh(
                body,
                np.zeros((vertices, 3), np.float32),
                np.zeros((triangles, 3), np.uint32),
                np.zeros(3, np.float32),
            )
            pointers = [ctypes.c_void_p(array.ctypes.data) for array in mesh[1:]]
            self._library.trocar_mesh(self._env, index, *pointers)
            meshes.append(mesh)
        return meshes

    def camera(self, lens: int, width: int, height: int) -> Camera:
        """The camera of a lens."""
        camera = Camera()
        self._library.trocar_camera(self._env, lens, width, height, ctypes.byref(camera))
        return camera

    def draw(self, lens: int, picture: Picture) -> None:
        """Draws what the lens sees."""
        height, width = picture.mask.shape
        pointers = [ctypes.c_void_p(array.ctypes.data) for array in picture]
        self._library.trocar_draw(self._env, lens, width, height, *pointers)


class Tiny:
    """The same meshes in a client of PyBullet."""

    def __init__(self, meshes: list[Mesh]) -> None:
        """Makes a visual body of each mesh."""
        self._client = pybullet.connect(pybullet.DIRECT)
        self.bodies = [0]
        """Trocar's number of the body of each of PyBullet's, shifted by one."""
        for mesh in meshes:
            shape = pybullet.createVisualShape(
                pybullet.GEOM_MESH,
                vertices=mesh.vertices.tolist(),
                indices=mesh.triangles.ravel().tolist(),
                rgbaColor=[*mesh.colour.tolist(), 1.0],
                physicsClientId=self._client,
            )
            if shape < 0:
                raise RuntimeError("PyBullet refused a mesh")
            pybullet.createMultiBody(baseVisualShapeIndex=shape, physicsClientId=self._client)
            self.bodies.append(mesh.body)

    def draw(self, camera: Camera, width: int, height: int) -> tuple[Any, ...]:
        """Draws what a camera sees."""
        fx, fy, cx, cy = camera.intrinsics
        near, far = camera.near, camera.far
        view = np.vstack([np.reshape(camera.camera_from_world, (3, 4)), (0, 0, 0, 1)])
        view = np.diag((1.0, -1.0, -1.0, 1.0)) @ view  # OpenGL's axes: right, up, backward
        projection = np.array(
            (
                (2 * fx / width, 0, 1 - (2 * cx + 1) / width, 0),
                (0, 2 * fy / height, (2 * cy + 1) / height - 1, 0),
                (0, 0, -(far + near) / (far - near), -2 * far * near / (far - near)),
                (0, 0, -1, 0),
            )
        )
        return tuple(
            pybullet.getCameraImage(
                width,
                height,
                viewMatrix=view.T.ravel().tolist(),
                projectionMatrix=projection.T.ravel().tolist(),
                lightDirection=list(camera.towards_lamp),
                shadow=1,
                renderer=pybullet.ER_TINY_RENDERER,
                physicsClientId=self._client,
            )
        )

    def picture(self, camera: Camera, drawn: tuple[Any, ...]) -> Picture:
        """What was drawn, with depths in m and Trocar's numbers of bodies."""
        width, height, rgb, depth, mask = drawn
        near, far = camera.near, camera.far
        depth = far * near / (far - (far - near) * np.reshape(depth, (height, width)))
        numbers = np.array(self.bodies)[np.maximum(np.reshape(mask, (height, width)) + 1, 0)]
        return Picture(np.reshape(rgb, (height, width, 4))[..., :3], depth, numbers)


def blank(width: int, height: int) -> Picture:
    """A picture to be drawn."""
    return Picture(
        np.zeros((height, width, 3), np.uint8),
        np.zeros((height, width), np.float32),
        np.zeros((height, width), np.int32),
    )


def milliseconds(draw: Any) -> float:
    """How long something takes."""
    start = time.perf_counter()
    draw()
    return 1e3 * (time.perf_counter() - start)


def compare(trocar: Trocar, tiny: Tiny, lens: int, size: tuple[int, int], rounds: int) -> Any:
    """Draws in turns; checks that both show the same."""
    width, height = size
    camera = trocar.camera(lens, width, height)
    ours = blank(width, height)
    trocar.draw(lens, ours)
    theirs = tiny.picture(camera, tiny.draw(camera, width, height))
    same = ours.mask == theirs.mask
    depths = np.abs(theirs.depth / ours.depth - 1)[same & (ours.mask > 0)]
    times: dict[str, list[float]] = {"trocar": [], "tiny": []}
    for _ in range(rounds):
        times["trocar"].append(milliseconds(lambda: trocar.draw(lens, ours)))
        times["tiny"].append(milliseconds(lambda: tiny.draw(camera, width, height)))
    ratios = sorted(b / a for a, b in zip(times["trocar"], times["tiny"], strict=True))
    return {
        "camera": LENSES[lens],
        "size": f"{width}x{height}",
        "trocar_ms": statistics.median(times["trocar"]),
        "tiny_ms": statistics.median(times["tiny"]),
        "ratio": statistics.median(ratios),
        "ratio_range": [ratios[0], ratios[-1]],
        "same_body": float(same.mean()),
        "depth_off": float(np.median(depths)),
    }


def main() -> None:
    """Compares and prints a table, or with ``--json`` one object a line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--simulation", required=True, help="libin_process.so, as an absolute path")
    parser.add_argument("--task", default="NeedlePick-v0")
    parser.add_argument("--rounds", type=int, default=15, help="pictures of each, in turns")
    parser.add_argument("--json", action="store_true", help="one JSON object per size, on stdout")
    arguments = parser.parse_args()
    trocar = Trocar(arguments.simulation, arguments.task, seed=3, steps=20)
    meshes = trocar.meshes()
    tiny = Tiny(meshes)
    triangles = sum(len(mesh.triangles) for mesh in meshes)
    print(f"{arguments.task}: {triangles} triangles in {len(meshes)} meshes, both", file=sys.stderr)
    for lens in range(len(LENSES)):
        for size in SIZES:
            found = compare(trocar, tiny, lens, size, arguments.rounds)
            if arguments.json:
                print(json.dumps(found), flush=True)
            low, high = found["ratio_range"]
            print(
                f"{found['camera']:<10} {found['size']:>7}: trocar {found['trocar_ms']:6.1f} ms, "
                f"tiny {found['tiny_ms']:6.0f} ms, "
                f"ratio {found['ratio']:5.1f} [{low:.1f}, {high:.1f}]; "
                f"the same body on {found['same_body']:.1%} of the pixels, "
                f"there depths are {found['depth_off']:.2%} apart",
                file=sys.stderr,
                flush=True,
            )


if __name__ == "__main__":
    main()
