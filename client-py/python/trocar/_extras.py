"""Extras of the package: one line with the remedy if one is not installed."""

from __future__ import annotations

import sys
from importlib import metadata


def missing_extra(error: ImportError, extra: str, purpose: str, command: str = "") -> ImportError:
    """The error to raise for a missing package, with the command that installs the extra.

    Args:
        error: Error of the import.
        extra: Name of the extra, e.g. ``rl``.
        purpose: Subject of the sentence, e.g. ``training``.
        command: Name of the module; ``python -m`` with that name ends with the line, without a
            traceback.
    """
    text = f"{error}; {purpose} needs the extra: {install_command(extra)}"
    if command and _runs_module(command):
        sys.exit(f"error: {text}")
    return ModuleNotFoundError(text, name=error.name)


def install_command(extra: str) -> str:
    """The command that installs an extra, without a search for the package itself.

    The name ``trocar`` is not reserved in the public package index. So the command names the
    installed version, which pip keeps. A source tree has no installed version.
    """
    try:
        version = metadata.version("trocar")
    except metadata.PackageNotFoundError:
        return f"the wheel with [{extra}], see Installation in docs/python.md"
    return f"pip install 'trocar[{extra}]=={version}'"


def _runs_module(name: str) -> bool:
    """True if this interpreter was started by ``python -m`` with the name, and still imports it."""
    words = sys.orig_argv
    is_importing = sys.argv[:1] == ["-m"]  # runpy replaces it after the import
    return is_importing and "-m" in words and words[words.index("-m") + 1 :][:1] == [name]
