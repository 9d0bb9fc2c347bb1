"""Figures of training runs, as the paper's: mean, standard deviation, standard error over seeds."""

from __future__ import annotations

import csv
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from trocar.errors import InvalidRequest, refuse
from trocar.rl.runs import Run


@dataclass(frozen=True)
class Curve:
    """What runs of one configuration and several seeds have in common."""

    task: str
    label: str
    """Algorithm, options where they are not the task's defaults, and curriculum if there is one."""
    runs: int
    """How many."""
    epochs: NDArray[np.float64]
    mean: NDArray[np.float64]
    """Of success, or of the return for tasks without goals, by epoch."""
    std: NDArray[np.float64]
    """Standard deviation over runs (of the sample; 0 for one run)."""

    @property
    def error(self) -> NDArray[np.float64]:
        """Standard error of the mean."""
        return self.std / float(np.sqrt(self.runs))


def is_of_returns(task: str) -> bool:
    """Whether a task is judged by its return, since it has no goals."""
    return task == "ActiveTrack-v0"


def find(folder: Path) -> list[Run]:
    """The runs in a folder and below.

    Raises:
        ValueError: There is none.
    """
    runs = [Run(path.parent) for path in sorted(folder.rglob("curve.csv"))]
    if not runs:
        raise refuse(InvalidRequest, "runs", str(folder), "expected a folder with runs in it")
    return runs


def curves(runs: list[Run]) -> list[Curve]:
    """The curves of runs, one for each task, algorithm and options; as long as the shortest."""
    groups: defaultdict[tuple[str, str], list[Run]] = defaultdict(list)
    for run in runs:
        config = run.config
        options = [f"{name}={value}" for name, value in sorted(config.task_options.items())]
        if config.curriculum:
            options.append(f"curriculum={config.curriculum}")
        groups[config.task, " ".join([config.algo, *options])].append(run)
    made = []
    for (task, label), members in sorted(groups.items()):
        column = "mean_return" if is_of_returns(task) else "success"
        values = [[row[column] for row in run.rows()] for run in members]
        length = min(map(len, values))
        table = np.array([row[:length] for row in values])
        std = table.std(axis=0, ddof=1) if len(table) > 1 else np.zeros(length)
        mean = table.mean(axis=0)
        made.append(Curve(task, label, len(table), np.arange(length, dtype=float), mean, std))
    return made


def plot(made: list[Curve], path: Path) -> None:
    """Draws curves, a panel for each task: light is the standard deviation, dark its error."""
    mpl.use("Agg")
    tasks = sorted({curve.task for curve in made})
    columns = min(len(tasks), 5)
    rows = -(-len(tasks) // columns)
    figure = Figure(figsize=(3.6 * columns, 3.4 * rows), dpi=100, layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False).flat
    for panel in panels:
        panel.set_visible(False)
    for panel, task in zip(figure.axes, tasks, strict=False):
        _panel(panel, task, [curve for curve in made if curve.task == task])
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)


def _panel(panel: Axes, task: str, made: list[Curve]) -> None:
    panel.set_visible(True)
    scale = 1.0 if is_of_returns(task) else 100.0
    for number, curve in enumerate(made):
        colour = f"C{number}"
        label = f"{curve.label} ({curve.runs})"
        panel.plot(curve.epochs, scale * curve.mean, color=colour, linewidth=1.4, label=label)
        for spread, alpha in ((curve.std, 0.15), (curve.error, 0.3)):
            low, high = (scale * (curve.mean + sign * spread) for sign in (-1, 1))
            panel.fill_between(curve.epochs, low, high, color=colour, alpha=alpha, linewidth=0)
    panel.set(title=task, xlabel="epoch")
    panel.set_ylabel("return" if is_of_returns(task) else "success, %")
    if not is_of_returns(task):
        panel.set_ylim(-3, 103)
    panel.grid(alpha=0.3)
    # Below: it hides no curve.
    panel.legend(
        loc="upper left",
        bbox_to_anchor=(0.0, -0.3),
        borderaxespad=0.0,
        frameon=False,
        fontsize="small",
    )


def plot_run(run: Run, path: Path) -> None:
    """Draws the curve of one run."""
    plot(curves([run]), path)


def write_table(made: list[Curve], path: Path) -> None:
    """Writes what the figure shows as CSV."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["task", "runs_of", "seeds", "epoch", "mean", "std", "standard_error"])
        for curve in made:
            for row in zip(curve.epochs, curve.mean, curve.std, curve.error, strict=True):
                numbers = [f"{number:.6g}" for number in row]
                writer.writerow([curve.task, curve.label, curve.runs, *numbers])
