"""A picture of an episode: where arms were sent and were, the goal, the policy, the topics."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from trocar._extras import install_command
from trocar.errors import Unsupported


def check_matplotlib() -> None:
    """Checks that :func:`plot` can draw.

    Raises:
        trocar.errors.Unsupported: ``matplotlib`` is missing.
    """
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise Unsupported(f"--plot needs matplotlib: {install_command('deploy')}") from error


def plot(path: Path) -> Path:
    """Draws an episode's file, as a PNG beside it.

    Raises:
        trocar.errors.Unsupported: ``matplotlib`` is missing.
    """
    check_matplotlib()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with np.load(path) as file:
        run = {name: file[name] for name in file.files}
    about = json.loads(str(run["about"]))
    figure = Figure(figsize=(9.0, 9.0), layout="constrained")
    FigureCanvasAgg(figure)
    where, goals, actions, ages = figure.subplots(4, 1, sharex=True)
    start = run["time"][0]
    for arm in sorted({name.split("/")[0] for name in run if name.endswith("/measured")}):
        _draw_arm(where, run, arm, start)
    if "desired_goal" in run:
        apart = np.linalg.norm(run["achieved_goal"] - run["desired_goal"], axis=1)
        goals.plot(run["time"] - start, apart, color="black")
        goals.set_yscale("log")
    for index, column in enumerate(run["action"].T):
        actions.step(run["time"][:-1][: len(column)] - start, column, where="post", label=index)
    for topic, column in zip(run["topics"], run["stamps"].T, strict=True):
        ages.plot(run["time"] - start, 1e3 * (run["time"] - column), label=str(topic))
    for axes, label in (
        (where, "from the start, m"),
        (goals, "achieved to\ndesired goal"),
        (actions, "action"),
        (ages, "age of stamps, ms"),
    ):
        axes.set_ylabel(label)
        if axes is not goals:
            axes.ticklabel_format(useOffset=False)
        axes.grid(alpha=0.3)
        if axes.get_legend_handles_labels()[0]:
            axes.legend(fontsize="x-small", ncols=4)
    ages.set_xlabel("s")
    words = f"{about['policy']} in {about['task']}, seed {about['seed']}: {about['outcome']}"
    figure.suptitle(f"{words}\n{about['why']}" if about["why"] else words)
    out = path.with_suffix(".png")
    figure.savefig(out, dpi=120)
    return out


def _draw_arm(axes: Any, run: dict[str, Any], arm: str, start: float) -> None:
    """Positions as measured, and as commanded where they are positions."""
    measured = run[f"{arm}/measured"]
    times = measured[:, 0] - measured[0, 0]
    colours = ("tab:red", "tab:green", "tab:blue")
    for axis, colour in zip(range(3), colours, strict=True):
        moved = measured[:, 1 + axis] - measured[0, 1 + axis]
        axes.plot(times, moved, color=colour, label=f"{arm} {'xyz'[axis]}")
        sent = run.get(f"{arm}/setpoint")
        if sent is not None and sent.shape[1] == 14:
            moved = sent[:, 1 + axis] - sent[0, 1 + axis]
            axes.plot(sent[:, 0] - start, moved, color=colour, linestyle=":")
