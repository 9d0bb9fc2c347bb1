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
    single = [row for row in rows if row["clients"] == 1]
    shared = [row for row in rows if row["envs"] == 16 and row["mode"] != "client_py"]
    figure = Figure(figsize=(9, 6), layout="constrained")
    panels = figure.subplots(2, 2, sharex="col", sharey="row")
    for (rates, shares), part, by, label in (
        (panels[:, 0], single, "envs", "environments of one client"),
        (panels[:, 1], shared, "clients", "Rust clients with 16 environments each"),
    ):
        found = curves(part, by)
        for (task, mode), points in found.items():
            colour, name = STYLE[mode]
            style = "-" if task.startswith("NeedlePick") else "--"
            alone = dict(found[task, "in_process"])
            ratios = [(number, rate / alone[number]) for number, rate in points]
            for axes, line in ((rates, points), (shares, ratios)):
                axes.plot(
                    *zip(*line, strict=True),
                    style,
                    color=colour,
                    marker=".",
                    label=f"{task}, {name}",
                )
        rates.set_yscale("log")
        shares.set(ylim=(0, 1.2), xlabel=label)
        for axes in (rates, shares):
            axes.set_xscale("log", base=2)
            axes.grid(visible=True, which="both", alpha=0.2)
    panels[0, 0].set_ylabel("environment steps per CPU second")
    panels[1, 0].set_ylabel("of that in-process, same work")
    panels[0, 0].legend(fontsize="x-small")
    figure.savefig(arguments.out, dpi=110)


if __name__ == "__main__":
    main()
