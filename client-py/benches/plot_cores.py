"""Draws how one session of 256 environments speeds up with threads: `make bench-cores` calls it.

Reads what ``trocar bench --json`` printed, one object a line, from stdin. Each curve is relative to
the rate of its task on one thread.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
from collections import defaultdict

from matplotlib.figure import Figure


def main() -> None:
    """Draws the picture."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("out", help="the PNG to write")
    arguments = parser.parse_args()
    found: dict[str, dict[int, list[float]]] = defaultdict(lambda: defaultdict(list))
    for row in map(json.loads, sys.stdin):
        found[row["task"]][row["threads"]].append(row["steps_per_second"])
    figure = Figure(figsize=(5.5, 4), layout="constrained")
    axes = figure.subplots()
    for task, rates in found.items():
        medians = {threads: statistics.median(rates[threads]) for threads in sorted(rates)}
        speedups = [rate / medians[1] for rate in medians.values()]
        axes.plot([*medians], speedups, marker=".", label=task)
    most = max(max(rates) for rates in found.values())
    axes.plot([1, most], [1, most], ":", color="grey", label="threads that share nothing")
    ticks = sorted({threads for rates in found.values() for threads in rates})
    axes.set(xlabel="threads", ylabel="times as fast as one", xticks=ticks)
    axes.grid(visible=True, alpha=0.2)
    axes.legend(fontsize="small")
    figure.savefig(arguments.out, dpi=110)


if __name__ == "__main__":
    main()
