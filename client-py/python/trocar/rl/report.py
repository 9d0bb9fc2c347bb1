"""The page of results: how well every run of a folder does, and what it took."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from statistics import mean, median
from typing import Any

from trocar.registration import TASKS
from trocar.rl.cards import AS_TRAINED, held_out_mark
from trocar.rl.config import ALGORITHMS
from trocar.rl.curves import curves, is_of_returns, label, plot, write_table
from trocar.rl.runs import Run
from trocar.rl.table import markdown

HEAD = """\
# Results

`python -m trocar.rl report {folder}` wrote this page from the files of the runs there. What they
mean, and how they compare with the paper, is told in [docs/paper.md](../../../../docs/paper.md).

- **evaluated**: by training seed, the part of held-out episodes whose last step succeeds; of
  ActiveTrack, the mean return, of at most 500. The policy is the one that scored best while it
  trained, on other episodes.
- **demonstrations**: episodes of the scripted expert before training.
- **expert labels**: states of the policy with an action of the expert, DAgger only; median over
  seeds.
- **late fall**: how far the mean of a run's last three scores lies below its best, in points.
- **trainer**, **server**, **wall**: medians over seeds of what a whole run took, with its scores,
  on machines with two cores that did other things too. PyTorch had one thread.
- **†**: not held out. Episodes of NeedleRegrasp, and of a `start` other than `reset`, began in 64
  prepared states, in training and in evaluation alike; only the goals differed.

"""
TESTED = """

## In conditions that they were not trained in

Means over seeds, and standard deviations of the sample; in brackets, how many seeds.

"""
OTHER_OPTIONS = """

## Under other options

The same for policies that were evaluated with `--option`.

"""

ABLATED = """
## What settings are worth

Runs that differ in the settings that they name, most of them shorter. The figures do not show
them.

"""

ABLATIONS = "ablations"
"""The folder of such runs."""


def write(runs: list[Run], folder: Path, page: Path, pictures: Path) -> None:
    """Writes the page, and its figures ``learning.png`` and ``minutes.png`` with their numbers."""
    ablations = [run for run in runs if ABLATIONS in run.path.relative_to(folder).parts]
    runs = [run for run in runs if run not in ablations]
    made = curves(runs)
    plot(made, pictures / "learning.png")
    plot(made, pictures / "minutes.png", minutes=True)
    write_table(made, pictures / "learning.csv")
    page.parent.mkdir(parents=True, exist_ok=True)
    figures = "".join(
        f"\n![{title}]({os.path.relpath(pictures / name, page.parent)})\n"
        for name, title in (
            ("minutes.png", "Success over minutes"),
            ("learning.png", "Success over epochs"),
        )
    )
    told = HEAD.format(folder=folder) + _table(runs)
    for heading, is_named in ((TESTED, True), (OTHER_OPTIONS, False)):
        if tested := [row for run in runs for row in _tested(run, is_named)]:
            told += heading + markdown(tested)
    told += "\n" + figures
    if ablations:
        told += ABLATED + _table(ablations) + "\n"
    page.write_text(told)


def _table(runs: list[Run]) -> str:
    """Runs, in Markdown: a row for each task and configuration."""
    groups: defaultdict[tuple[str, str], list[Run]] = defaultdict(list)
    for run in sorted(runs, key=_place):
        groups[run.config.task, label(run.config)].append(run)
    header = ["task", "algorithm", "seeds", "evaluated", "mean", "demonstrations", "expert labels"]
    header += ["late fall", "trainer", "server", "wall"]
    lines = [header, ["---"] * len(header)]
    lines += [_row(task, name, members) for (task, name), members in groups.items()]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _place(run: Run) -> tuple[int, int, str, int]:
    """Where a run stands in the table."""
    config = run.config
    return (
        list(TASKS).index(config.task),
        -ALGORITHMS.index(config.algo),
        label(config),
        run.seed,
    )


def _row(task: str, name: str, runs: list[Run]) -> list[str]:
    results = [value for run in runs if (value := _result(run)) is not None]
    times = {
        column: median(run.rows()[-1][column] for run in runs)
        for column in ("trainer_cpu_s", "server_cpu_s", "wall_s")
    }
    unit = "" if is_of_returns(task) else " %"
    return [
        task.removesuffix("-v0") + held_out_mark(runs[0].config),
        name,
        _joined(run.seed for run in runs),
        _joined(f"{value:.1f}" for value in results) or "-",
        f"{mean(results):.1f}{unit}" if results else "-",
        str(runs[0].config.demos or "-"),
        f"{median(map(_labels, runs)):.0f}" if runs[0].config.algo == "dagger" else "-",
        _joined(f"{_late_fall(run):.0f}" for run in runs if len(run.rows()) > 3) or "-",
        f"{times['trainer_cpu_s']:.0f} CPU s",
        f"{times['server_cpu_s']:.0f} CPU s",
        f"{times['wall_s']:.0f} s",
    ]


def _joined(values: Iterable[Any]) -> str:
    return ", ".join(map(str, values))


def _result(run: Run) -> float | None:
    """What the best policy's latest evaluation gives, %, or its return."""
    for told in reversed(run.evaluations()):
        if told["policy"] == "best" and told["condition"] == AS_TRAINED:
            rate = told["success_rate"]
            return float(told["mean_return"] if rate is None else 100 * rate)
    return None


def _tested(run: Run, is_named: bool) -> list[dict[str, Any]]:
    """Evaluations of a run in other conditions, with that as trained; or under other options."""
    found = [
        told
        for told in run.evaluations()
        if told["policy"] == "best" and (told["condition"] is not None) == is_named
    ]
    return found if any(told["condition"] != AS_TRAINED for told in found) else []


def _labels(run: Run) -> int:
    """Number of states that DAgger had the expert label: each step of the policy in training."""
    return int(run.rows()[-1]["steps"])


def _late_fall(run: Run) -> float:
    """How far the mean of the last three scores lies below the best, points."""
    is_return = is_of_returns(run.config.task)
    column, scale = ("mean_return", 1.0) if is_return else ("success", 100.0)
    scores = [scale * row[column] for row in run.rows()]
    return max(scores) - mean(scores[-3:])
