"""Checks the binaries in wheels: `python3 tests/wheels.py WHEEL…`; `make wheels` runs it.

A binary has neither debug information nor a table of symbols, and needs no newer glibc than the
wheel's name promises. Sizes are printed: of the wheel, and on disk.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

PROMISED = re.compile(r"manylinux_(\d+)_(\d+)_")
NEEDED = re.compile(r"\bGLIBC_(\d+)\.(\d+)\b")
DEBUG_SECTIONS = frozenset([".symtab", ".debug_info", ".debug_line"])


def sections(path: Path) -> set[str]:
    """The names of the sections of a binary."""
    text = objdump("--section-headers", path) + objdump("--syms", path)
    found = set(re.findall(r"^\s*\d+ (\.\S+)", text, re.MULTILINE))
    return found if "no symbols" in text else found | {".symtab"}


def objdump(flag: str, path: Path) -> str:
    """What objdump prints of a binary."""
    command = ["objdump", flag, str(path)]
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout


def check(wheel: Path, folder: Path) -> list[str]:
    """The faults of a wheel, which is unpacked in a folder."""
    versions = [tuple(map(int, found)) for found in PROMISED.findall(wheel.name)]
    if not versions:
        return [f"{wheel.name}: the name promises no version of glibc"]
    with zipfile.ZipFile(wheel) as file:
        names = [name for name in file.namelist() if name.endswith(".so") or "/scripts/" in name]
        size = sum(entry.file_size for entry in file.infolist())
        binaries = [Path(file.extract(name, folder)) for name in names]
    print(f"{wheel.name}: {wheel.stat().st_size / 1e6:.1f} MB, {size / 1e6:.1f} MB on disk")
    faults = [] if binaries else [f"{wheel.name} has no binary"]
    for path in binaries:
        found = sections(path) & DEBUG_SECTIONS
        if found:
            faults.append(f"{wheel.name}: {path.name} is not stripped: {sorted(found)}")
        needed = {tuple(map(int, found)) for found in NEEDED.findall(objdump("-T", path))}
        if max(needed) > min(versions):
            faults.append(f"{wheel.name}: {path.name} needs glibc {max(needed)}")
    return faults


def main(arguments: list[str]) -> int:
    """Checks wheels; the exit status."""
    with tempfile.TemporaryDirectory() as folder:
        faults = [
            fault
            for number, wheel in enumerate(arguments)
            for fault in check(Path(wheel), Path(folder, str(number)))
        ]
    print("\n".join(faults), file=sys.stderr, end="\n" if faults else "")
    return int(bool(faults))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
