"""Command lines: errors of one line, and paths of output that are checked before work begins."""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import NoReturn


class Parser(argparse.ArgumentParser):
    """A parser that prints an error as one line, without the usage of all arguments."""

    def error(self, message: str) -> NoReturn:
        """Prints the error and exits with status 2."""
        self.exit(2, f"error: {message}; {self.prog} --help lists the arguments\n")


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


def output_file_in_folder(text: str) -> Path:
    """Path of a file whose folder is made if it is missing; the path is left unchanged.

    Raises:
        argparse.ArgumentTypeError: File or folder cannot be written.
    """
    path = Path(text)
    if path.parent.exists():
        return output_file(text)
    output_folder(str(path.parent))
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
