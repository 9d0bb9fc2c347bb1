"""Tables of evaluations: how policies trained under some options do under others."""

from __future__ import annotations

import json
from collections import defaultdict
from pathlib import Path
from statistics import mean, stdev
from typing import Any

from trocar.errors import InvalidRequest, refuse
from trocar.rl.curves import assignment

FIELDS = ("task", "algo", "run", "trained_with", "options", "success_rate", "mean_return")


def read(path: Path) -> list[dict[str, Any]]:
    """Evaluations, as ``python -m trocar.rl evaluate`` prints them: one JSON object a line.

    Raises:
        ValueError: A line is something else, or there is none.
    """
    evaluations = []
    for number, line in enumerate(path.read_text().splitlines(), 1):
        try:
            evaluation = json.loads(line)
        except ValueError:
            evaluation = None
        if not isinstance(evaluation, dict) or any(field not in evaluation for field in FIELDS):
            allowed = "expected what `evaluate` prints"
            raise refuse(InvalidRequest, f"{path}:{number}", line[:60], allowed)
        evaluations.append(evaluation)
    if not evaluations:
        raise refuse(InvalidRequest, "evaluations", str(path), "expected a line for each")
    return evaluations


def markdown(evaluations: list[dict[str, Any]]) -> str:
    """A row for each way of training (task, algorithm, options), a column for each condition.

    Cells are means over policies and their standard deviation (of the sample), in % of successes,
    or returns for tasks without goals. A run's latest evaluation under the same options counts.
    """
    cells: defaultdict[tuple[str, str], dict[str, float]] = defaultdict(dict)
    for each in evaluations:
        row = " ".join([each["task"], each["algo"], _named(each["trained_with"])])
        rate, score = each["success_rate"], each["mean_return"]
        tested = each.get("condition") or _named(each["options"])
        cells[row, tested][each["run"]] = score if rate is None else 100 * rate
    rows, columns = (list(dict.fromkeys(names)) for names in zip(*cells, strict=True))
    lines = [["trained", *columns], ["---"] * (len(columns) + 1)]
    lines += [
        [row, *(_cell(list(cells[row, column].values())) for column in columns)] for row in rows
    ]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _named(options: dict[str, Any]) -> str:
    named = (assignment(name, value) for name, value in sorted(options.items()))
    return " ".join(named) or "defaults"


def _cell(values: list[float]) -> str:
    if len(values) < 2:
        return f"{values[0]:.1f}" if values else ""
    return f"{mean(values):.1f} ± {stdev(values):.1f} ({len(values)})"
