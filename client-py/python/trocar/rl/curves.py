"""Figures of training runs, as the paper's: mean, standard deviation, standard error over seeds."""

from __future__ import annotations

import csv
import json
import textwrap
from collections import defaultdict
from dataclasses import asdict, dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter
from numpy.typing import NDArray

from trocar.errors import InvalidRequest, refuse
from trocar.registration import SERVED, TASKS
from trocar.rl.config import Config, load
from trocar.rl.runs import Run


@dataclass(frozen=True)
class Curve:
    """What runs of one configuration and several seeds have in common."""

    task: str
    label: str
    """As :func:`label` gives it."""
    runs: int
    """How many."""
    mean: NDArray[np.float64]
    """Of success, or of the return for tasks without goals, by epoch."""
    std: NDArray[np.float64]
    """Standard deviation over runs (of the sample; 0 for one run)."""
    cpu_minutes: NDArray[np.float64]
    """Processor time of trainer and server until then, min; mean over runs."""
    wall_minutes: NDArray[np.float64]
    """Time until then, min; mean over runs."""

    @property
    def epochs(self) -> NDArray[np.float64]:
        """Their numbers."""
        return np.arange(len(self.mean), dtype=float)

    @property
    def error(self) -> NDArray[np.float64]:
        """Standard error of the mean."""
        return self.std / float(np.sqrt(self.runs))


def is_of_returns(task: str) -> bool:
    """Whether a task is judged by its return, since it has no goals."""
    return task == "ActiveTrack-v0"


def changes(config: Config) -> dict[str, object]:
    """What a configuration has otherwise than the one of its task and algorithm, but options."""
    usual = asdict(load(config.task, config.algo))
    named = {name: value for name, value in asdict(config).items() if value != usual[name]}
    named.pop("task_options", None)
    return named


def label(config: Config) -> str:
    """An algorithm, with options and values that are not the usual ones."""
    usual = load(config.task, config.algo).task_options
    options = {
        name: value for name, value in config.task_options.items() if value != usual.get(name)
    }
    named = sorted(options.items()) + sorted(changes(config).items())
    return " ".join([config.algo, *(assignment(name, value) for name, value in named)])


def assignment(name: str, value: object) -> str:
    """``NAME=VALUE``, as the command line takes it."""
    return f"{name}={value if isinstance(value, str) else json.dumps(value)}"


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
        groups[run.config.task, label(run.config)].append(run)
    return [_curve(task, name, members) for (task, name), members in sorted(groups.items())]


def _curve(task: str, name: str, runs: list[Run]) -> Curve:
    rows = [run.rows() for run in runs]
    length = min(map(len, rows))

    def table(*columns: str) -> NDArray[np.float64]:
        """Sums of columns by run and epoch."""
        return np.array(
            [
                [sum(row.get(column, 0.0) for column in columns) for row in of[:length]]
                for of in rows
            ]
        )

    values = table("mean_return" if is_of_returns(task) else "success")
    return Curve(
        task,
        name,
        runs=len(runs),
        mean=values.mean(axis=0),
        std=values.std(axis=0, ddof=1) if len(runs) > 1 else np.zeros(length),
        cpu_minutes=table("trainer_cpu_s", "server_cpu_s").mean(axis=0) / 60,
        wall_minutes=table("wall_s").mean(axis=0) / 60,
    )


def plot(made: list[Curve], path: Path, *, minutes: bool = False) -> None:
    """Draws curves, a panel for each task.

    Args:
        made: The curves.
        path: The file.
        minutes: Whether they are drawn over minutes, with a logarithmic axis: those of processors
            solid, those of the wall dashed. Otherwise over epochs: light is the standard
            deviation over seeds, dark its error.
    """
    mpl.use("Agg")
    tasks = [task for task in (*TASKS, *SERVED) if any(curve.task == task for curve in made)]
    columns = min(len(tasks), 5)
    rows = -(-len(tasks) // columns)
    figure = Figure(figsize=(3.6 * columns, 3.4 * rows), dpi=100, layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False).flat
    for panel in panels:
        panel.set_visible(False)
    for panel, task in zip(figure.axes, tasks, strict=False):
        panel.set_visible(True)
        for number, curve in enumerate(curve for curve in made if curve.task == task):
            (_over_minutes if minutes else _over_epochs)(panel, curve, f"C{number}")
        _finish(panel, task)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)


def _over_epochs(panel: Axes, curve: Curve, colour: str) -> None:
    scale = _scale(curve.task)
    panel.plot(curve.epochs, scale * curve.mean, ".-", color=colour, ms=3, label=_legend(curve))
    for spread, alpha in ((curve.std, 0.15), (curve.error, 0.3)):
        low, high = (scale * (curve.mean + sign * spread) for sign in (-1, 1))
        panel.fill_between(curve.epochs, low, high, color=colour, alpha=alpha, linewidth=0)
    panel.set_xlabel("epoch")


def _over_minutes(panel: Axes, curve: Curve, colour: str) -> None:
    values = _scale(curve.task) * curve.mean
    panel.plot(curve.cpu_minutes, values, ".-", color=colour, ms=4, label=_legend(curve))
    panel.plot(curve.wall_minutes, values, "--", color=colour, linewidth=0.8)
    panel.set_xscale("log")
    # The same for all panels: from three seconds to two hours.
    panel.set_xlim(0.05, 120.0)
    panel.set_xticks([0.1, 1.0, 10.0, 100.0], labels=["0.1", "1", "10", "100"])
    panel.xaxis.set_minor_formatter(NullFormatter())
    panel.set_xlabel("minutes (processors: solid, wall: dashed)")


def _scale(task: str) -> float:
    return 1.0 if is_of_returns(task) else 100.0


def _legend(curve: Curve) -> str:
    return textwrap.fill(f"{curve.label} ({curve.runs})", 44)


def _finish(panel: Axes, task: str) -> None:
    panel.set_title(task)
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
        header = ["task", "runs_of", "seeds", "epoch", "mean", "std", "standard_error"]
        writer.writerow([*header, "cpu_minutes", "wall_minutes"])
        for curve in made:
            columns = (curve.epochs, curve.mean, curve.std, curve.error)
            for row in zip(*columns, curve.cpu_minutes, curve.wall_minutes, strict=True):
                numbers = [f"{number:.6g}" for number in row]
                writer.writerow([curve.task, curve.label, curve.runs, *numbers])
