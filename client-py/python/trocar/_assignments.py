"""Options as text: the flag ``--option`` of all commands, in the syntax of the program ``trocar``.

``NAME=VALUE``; lists are ``NAME=A,B``, rows of a table ``NAME.ROW=LOW,HIGH``. JSON is accepted too.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any

from trocar.errors import InvalidOption, refuse

SYNTAX = "NAME=VALUE, lists as NAME=A,B, rows of a table as NAME.ROW=LOW,HIGH; JSON values too"
"""The syntax, for help texts."""

LISTS = frozenset(["observation"])
"""Options whose value is a list, also of a single word."""


def assignments(given: Iterable[str], flag: str = "--option") -> dict[str, Any]:
    """The values of flags by the name of their option; rows of one table are joined.

    Raises:
        trocar.errors.InvalidOption: A flag is no assignment.
    """
    found: dict[str, Any] = {}
    for assignment in given:
        path, equals, text = assignment.partition("=")
        name, point, row = path.partition(".")
        if not equals or not name or bool(point) != bool(row):
            raise refuse(InvalidOption, flag, assignment, f"expected {SYNTAX}")
        read = value(text)
        if point:
            table = found.get(name)
            found[name] = {**(table if isinstance(table, dict) else {}), row: read}
        elif isinstance(read, dict) and isinstance(found.get(name), dict):
            found[name] |= read
        else:
            found[name] = [read] if name in LISTS and isinstance(read, str) else read
    return found


def value(text: str) -> Any:
    """The value of a text: JSON, a list if there are commas, else a word.

    Raises:
        trocar.errors.InvalidOption: The text begins like JSON, and is none.
    """
    try:
        return json.loads(text)
    except ValueError:
        if text.lstrip()[:1] in ("[", "{", '"'):
            allowed = "this is neither a word nor JSON"
            raise refuse(InvalidOption, "value", text, allowed) from None
    if "," in text:
        return [value(part.strip()) for part in text.split(",")]
    return text
