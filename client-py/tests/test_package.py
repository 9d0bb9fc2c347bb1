"""The package itself: stubs, the program it finds, examples."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest

import trocar
from trocar._extras import install_command

EXAMPLES = Path(__file__).parent.parent / "examples"


def run(*arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-W", "error", *arguments],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        stdin=subprocess.DEVNULL,
        env={**os.environ, **variables},
    )


def test_stubs_are_those_of_the_module() -> None:
    pytest.importorskip("mypy")
    # Warnings of mypy's own are no business of ours.
    checked = subprocess.run(
        [sys.executable, "-m", "mypy.stubtest", "trocar._trocar"],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert checked.returncode == 0, checked.stdout


def test_the_package_depends_on_the_program_of_its_own_version() -> None:
    metadata = (Path(__file__).parent.parent / "pyproject.toml").read_text()
    assert re.findall('"trocar-server(.*)"', metadata) == [f"=={trocar.__version__}"]


def test_the_module_says_where_the_program_is() -> None:
    said = run("-m", "trocar")
    assert said.stdout.strip() == trocar.binary()
    assert said.returncode == 0


def test_the_module_runs_the_program() -> None:
    said = run("-m", "trocar", "--version")
    assert trocar.__version__ in said.stdout
    assert said.returncode == 0


def test_a_missing_program_gets_advice(tmp_path: Path) -> None:
    if (Path(sys.executable).parent / "trocar").exists():
        pytest.skip("the program is installed beside this Python")
    said = run("-m", "trocar", PATH=str(tmp_path), TROCAR_BINARY="")
    assert "install the wheel trocar-server" in said.stderr
    assert said.returncode != 0


def test_the_random_policy_example_runs(server: str) -> None:
    done = run(str(EXAMPLES / "random_policy.py"), server)
    assert done.returncode == 0, done.stderr
    assert "expert: 8 of 8" in done.stdout


@pytest.mark.parametrize(
    ("command", "package", "extra"),
    [
        (["-m", "trocar.rl", "configs"], "matplotlib", "rl"),
        (["-m", "trocar.rl", "configs"], "onnx", "rl"),
        (["-m", "trocar.demos", "--task", "NeedleReach-v0"], "minari", "demos"),
        (
            ["-m", "trocar.dvrk.deploy", "NeedleReach", "--log", "logs", "--plot"],
            "matplotlib",
            "deploy",
        ),
    ],
)
def test_a_missing_extra_is_one_line_with_the_remedy(
    command: list[str],
    package: str,
    extra: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    hide(package, tmp_path)
    monkeypatch.chdir(tmp_path)
    said = run(*command, PYTHONPATH=f"{tmp_path}:{Path(trocar.__file__).parents[1]}")
    assert said.returncode != 0
    assert install_command(extra) in said.stderr
    assert len(said.stderr.splitlines()) == 1, said.stderr
    assert not (tmp_path / "logs").exists()


def test_the_command_for_an_extra_names_the_installed_version(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(metadata, "version", lambda _: "1.2.3")
    assert install_command("rl") == "pip install 'trocar[rl]==1.2.3'"


def test_a_source_tree_names_no_package_of_the_index(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_: str) -> str:
        raise metadata.PackageNotFoundError

    monkeypatch.setattr(metadata, "version", fail)
    assert "pip install" not in install_command("rl")
    assert "[rl]" in install_command("rl")


def test_imports_without_an_extra_raise_an_import_error_with_the_remedy(tmp_path: Path) -> None:
    hide("stable_baselines3", tmp_path)
    hide("matplotlib", tmp_path)
    for module, extra in (("trocar.sb3", "sb3"), ("trocar.rl", "rl")):
        code = f"try: import {module}\nexcept ImportError as error: print(error)"
        said = run("-c", code, PYTHONPATH=f"{tmp_path}:{Path(trocar.__file__).parents[1]}")
        assert said.stdout.strip().endswith(install_command(extra)), said.stderr


def hide(package: str, folder: Path) -> None:
    """Puts a module into a folder that fails as if the package were not installed."""
    text = f"raise ModuleNotFoundError('no package {package}')"
    (folder / f"{package}.py").write_text(text)
