#!/usr/bin/env python3
"""Writes every model of this folder: URDFs and OBJ meshes, the same bytes each time.

    python3 assets/generate.py           write the files
    python3 assets/generate.py --check   exit with 1 if a file is missing, changed or left over

Needs Python 3.10 or later and nothing else.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from modelling import cube, ecm, gauze, peg_transfer, psm, scene

ASSETS = Path(__file__).resolve().parent


def generate() -> dict[str, str]:
    """Path below this folder to text, for every generated file."""
    files: dict[str, str] = {}
    classic = psm.model(psm.CLASSIC)
    files |= classic.files() | psm.model(psm.SI, classic).files()
    for urdf_name in ecm.ENDOSCOPES:
        classic = ecm.model(ecm.CLASSIC, urdf_name)
        files |= classic.files(urdf_name)
        files |= ecm.model(ecm.SI, urdf_name, classic).files(urdf_name)
    objects = [scene.needle(), scene.cylinder(), gauze.gauze(), peg_transfer.block()]
    static_bodies = [scene.pad(), scene.tray(), scene.table(), peg_transfer.pegboard()]
    for model in objects + static_bodies:
        files |= model.files()
    for urdf_name in cube.EDGES:
        files |= cube.cube(urdf_name).files(urdf_name)
    return files


def differences(files: dict[str, str]) -> list[str]:
    """What is not as generated, in words."""
    found = []
    for name, text in files.items():
        path = ASSETS / name
        if not path.is_file():
            found.append(f"missing: {name}")
        elif path.read_bytes() != text.encode():
            found.append(f"changed: {name}")
    for path in sorted([*ASSETS.glob("*/*.urdf"), *ASSETS.glob("*/meshes/*")]):
        name = path.relative_to(ASSETS).as_posix()
        if name not in files:
            found.append(f"left over: {name}")
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description="Writes the models' URDFs and meshes.")
    parser.add_argument("--check", action="store_true", help="compare instead of writing")
    check = parser.parse_args().check
    files = generate()
    if check:
        found = differences(files)
        print("\n".join(found) or f"{len(files)} files are as generated")
        return 1 if found else 0
    for name, text in files.items():
        path = ASSETS / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(text.encode())
    print(f"wrote {len(files)} files, {sum(map(len, files.values())) // 1024} KiB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
