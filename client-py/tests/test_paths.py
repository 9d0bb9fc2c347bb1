"""Paths of output are checked before work begins."""

import argparse
from pathlib import Path

import pytest

from trocar._paths import output_file, output_folder


def test_paths_that_can_be_written_are_left_unchanged(tmp_path: Path) -> None:
    file = tmp_path / "policy.onnx"
    assert output_file(str(file)) == file
    folder = tmp_path / "runs" / "one"
    assert output_folder(str(folder)) == folder
    assert not list(tmp_path.iterdir())
    file.write_bytes(b"there")
    assert output_file(str(file)) == file
    assert file.read_bytes() == b"there"


def test_other_paths_are_refused_by_name(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "missing" / "policy.onnx", Path("/proc/policy.onnx")):
        with pytest.raises(argparse.ArgumentTypeError, match=path.name):
            output_file(str(path))
    file = tmp_path / "file"
    file.touch()
    for path in (file, file / "runs", Path("/proc/runs")):
        with pytest.raises(argparse.ArgumentTypeError, match=path.name):
            output_folder(str(path))
