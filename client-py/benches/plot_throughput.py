"""Draws throughput against environments and clients, as `make bench-plot` measures it.

Reads what ``trocar bench --json`` printed, one object a line, from stdin. Steps per second are
those of CPU time, of the server and its clients together: how many steps one core does.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
from collections import defaultdict
from typing import Any

from matplotlib.figure import Figure

STYLE = {
    "in_process": ("k", "in-process"),
    "client_rs": ("C0", "Rust"),
    "client_py": ("C1", "Python"),
}


def curves(rows: list[dict[str, Any]], by: str) -> dict[tuple[str, str], list[tuple[int, float]]]:
    """For each task and mode, the median rate over the repetitions, by number."""
    found: dict[tuple[str, str], dict[int, list[float]]] = defaultdict(lambda: defaultdict(list))
    for row in rows:
        found[row["task"], row["mode"]][row[by]].append(row["steps_per_cpu_second"])
    return {
        key: [(number, statistics.median(rates)) for number, rates in sorted(points.items())]
        for key, points in found.items()
    }


def main() -> None:
    """Draws both panels."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("out", help="the PNG to write")
    arguments = parser.parse_args()
    rows = [json.loads(line) for line in sys.stdin]
    single = [row for row in rows if row["clients"] == 1 and row["envs"] > 1]
    shared = [row for row in rows if row["envs"] == 16 and row["mode"] == "client_rs"]
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    for axes, part, by, label in (
        (left, single, "envs", "environments of one client"),
        (right, shared, "clients", "Rust clients with 16 environments each"),
    ):
        for (task, mode), points in curves(part, by).items():
            colour, name = STYLE[mode]
            style = "-" if task.startswith("NeedlePick") else "--"
            axes.plot(
                *zip(*points, strict=True), style, color=colour, marker=".", label=f"{task}, {name}"
            )
        axes.set(xscale="log", yscale="log", xlabel=label)
        axes.set_xscale("log", base=2)
        axes.grid(visible=True, which="both", alpha=0.2)
    left.set_ylabel("environment steps per CPU second")
    left.legend(fontsize="x-small")
    figure.savefig(arguments.out, dpi=110)


if __name__ == "__main__":
    main()
