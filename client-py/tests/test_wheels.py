"""The check of wheels: binaries are stripped and need no newer glibc than the name promises."""

import importlib.util
import shutil
import zipfile
from pathlib import Path
from typing import Any

import pytest

import trocar

ROOT = Path(__file__).resolve().parents[2]

pytestmark = pytest.mark.skipif(shutil.which("objdump") is None, reason="needs objdump")


@pytest.fixture(scope="module")
def wheels() -> Any:
    spec = importlib.util.spec_from_file_location("wheels", ROOT / "tests" / "wheels.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_debug_information_and_a_newer_glibc_are_faults(wheels: Any, tmp_path: Path) -> None:
    def faults(name: str, program: str) -> list[str]:
        path = tmp_path / name
        with zipfile.ZipFile(path, "w") as file:
            file.write(program, "trocar_server-0.1.0.data/scripts/trocar")
        found: list[str] = wheels.check(path, tmp_path / "unpacked")
        return found

    new, old = (f"trocar_server-0.1.0-py3-none-manylinux_2_{n}_x86_64.whl" for n in (99, 5))
    system = str(shutil.which("sh"))
    assert faults(new, system) == []
    assert ["glibc" in fault for fault in faults(old, system)] == [True]
    debug = faults(new, str(trocar.binary()))
    assert ["not stripped" in fault for fault in debug] == [True]
    assert len(faults("trocar_server-0.1.0-py3-none-linux_x86_64.whl", system)) == 1
