"""Paths of output, checked before work begins: types of arguments for ``argparse``."""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path


def output_file(text: str) -> Path:
    """Path of a file that can be written; the path is left unchanged.

    Raises:
        argparse.ArgumentTypeError: It cannot be written.
    """
    path = Path(text)
    try:
        is_new = not path.exists()
        path.open("ab").close()
        if is_new:
            path.unlink()
    except OSError as error:
        raise argparse.ArgumentTypeError(f"{path}: {error.strerror}") from None
    return path


def output_folder(text: str) -> Path:
    """Path of a folder that is there or can be made, and takes files.

    Raises:
        argparse.ArgumentTypeError: It is no such folder.
    """
    path = Path(text)
    there = next(folder for folder in (path, *path.absolute().parents) if folder.exists())
    try:
        with tempfile.TemporaryFile(dir=there):
            pass
    except OSError as error:
        raise argparse.ArgumentTypeError(f"{path}: {error.strerror}") from None
    return path
