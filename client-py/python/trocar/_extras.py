"""Extras of the package: one line with the remedy if one is not installed."""

from __future__ import annotations

import sys


def missing_extra(error: ImportError, extra: str, purpose: str, command: str = "") -> ImportError:
    """The error to raise for a missing package, with the command that installs the extra.

    Args:
        error: Error of the import.
        extra: Name of the extra, e.g. ``rl``.
        purpose: Subject of the sentence, e.g. ``training``.
        command: Name of the module; ``python -m`` with that name ends with the line, without a
            traceback.
    """
    text = f"{error}; {purpose} needs the extra: pip install trocar[{extra}]"
    if command and _runs_module(command):
        sys.exit(f"error: {text}")
    return ModuleNotFoundError(text, name=error.name)


def _runs_module(name: str) -> bool:
    """True if this interpreter was started by ``python -m`` with the name, and still imports it."""
    words = sys.orig_argv
    is_importing = sys.argv[:1] == ["-m"]  # runpy replaces it after the import
    return is_importing and "-m" in words and words[words.index("-m") + 1 :][:1] == [name]
