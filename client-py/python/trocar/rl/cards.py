"""Cards of policies: how each was trained, and how well it does, also where it was not trained."""

from __future__ import annotations

import shlex
from typing import Any

from trocar.errors import InvalidRequest, refuse
from trocar.registration import TASKS, schedule
from trocar.rl.config import Config
from trocar.rl.curves import assignment, changes
from trocar.rl.runs import Run

PAGE = """\
# Policies

The best policy known of each task, as the program has it under its task's name: `trocar rollout
--policy NeedlePick --view` shows it at work, `trocar policies` tells what its card says. The files
are ONNX, with their features inside; what their cards say is in their metadata.

The policy of a task is the one that scored best while it trained, of all runs; of equals, the one
with the higher return. The table's figures are of 200 other episodes, and count those whose last
step succeeds. The last columns are conditions that it was not trained in: twice as many steps a
second, arms that are 60 ms late, and noise of 0.5 mm that they add to each command. A policy with
"contact" needs `observation=("state", "contact")`.

The figures are of arms without errors. † marks figures that are not held out: such episodes began
in 64 prepared states, in training and in evaluation alike.

{table}

Each film is the episode of seed 0, as it came:

{gallery}

These commands made them; `make policies` and `make pictures` write this folder.

```sh
{commands}
```
"""

AS_TRAINED = "as trained"
"""The condition in which a policy was trained."""


def held_out_mark(config: Config) -> str:
    """A dagger where evaluation begins in the 64 prepared states of the training, else nothing.

    These are the beginnings of NeedleRegrasp, and of each ``start`` other than ``"reset"``.
    """
    prepared = config.task_options.get("start", "reset") != "reset"
    return " †" if prepared or config.task == "NeedleRegrasp-v0" else ""


def conditions(config: Config) -> dict[str, dict[str, Any]]:
    """Conditions in which policies are evaluated, by name: options beside those of the training."""
    domain = config.task_options.get("domain", {})
    return {
        AS_TRAINED: {},
        "twice the rate": {"rate": 2 * schedule(config.task)[1]},
        "60 ms late": {"domain": domain | {"latency_seconds": [0.06, 0.06]}},
        "noise 0.5 mm": {"domain": domain | {"action_noise": [0.0005, 0.0005]}},
    }


def card(run: Run, which: str = "best") -> dict[str, Any]:
    """How a run's policy was trained and how well it does, as its ONNX file tells it.

    Args:
        run: The run, which was evaluated.
        which: ``best`` or ``last``.

    Raises:
        ValueError: That policy was not evaluated.
    """
    config = run.config
    found = {told["condition"]: told for told in run.evaluations() if told["policy"] == which}
    if AS_TRAINED not in found:
        allowed = f"expected one that was evaluated: python -m trocar.rl evaluate {run.path}"
        raise refuse(InvalidRequest, "run", str(run.path), allowed)
    results = ("seed", "episodes", "success_rate", "confidence_95", "mean_return", "mean_length")
    times = {name: run.rows()[-1][name] for name in ("wall_s", "trainer_cpu_s", "server_cpu_s")}
    return {
        "algorithm": config.algo,
        "command": command(run),
        "needs_contact": config.contact,
        "mark": held_out_mark(config),
        **times,
        **{name: found[AS_TRAINED][name] for name in results},
        "conditions": [
            {"name": condition} | {name: told[name] for name in ("options", *results)}
            for condition, told in found.items()
            if condition not in (AS_TRAINED, None)
        ],
    }


def best(runs: list[Run]) -> list[Run]:
    """Of each task, in their usual order, the run whose policy scored best while it trained.

    Those scores are of other episodes than a card's. Of equals, the one with the higher return.
    """

    def worth(run: Run) -> tuple[float, float]:
        return max((row["success"], row["mean_return"]) for row in run.rows())

    found: dict[str, Run] = {}
    for run in sorted(runs, key=worth):
        found[run.config.task] = run
    return [found[task] for task in TASKS if task in found]


def page(cards: dict[str, dict[str, Any]]) -> str:
    """A page that shows policies: cards by task."""
    names = [condition["name"] for card in cards.values() for condition in card["conditions"]]
    names = list(dict.fromkeys(names))
    lines = [
        ["task", "algorithm", "trained in", AS_TRAINED, "95 %", *names],
        ["---"] * (5 + len(names)),
    ]
    for task, card in cards.items():
        results = {each["name"]: _result(each) for each in card["conditions"]}
        seconds = card["trainer_cpu_s"] + card["server_cpu_s"]
        low_high = card["confidence_95"]
        lines.append(
            [
                task.removesuffix("-v0"),
                card["algorithm"] + (", contact" if card["needs_contact"] else ""),
                f"{seconds:.0f} CPU s",
                _result(card) + card["mark"],
                "{:.1f} to {:.1f} %".format(*(100 * end for end in low_high)) if low_high else "-",
                *(results.get(name, "-") for name in names),
            ]
        )
    table = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    films = [f"![{task}]({task}.gif) **{task.removesuffix('-v0')}**" for task in cards]
    pairs = [f"| {' | '.join(films[first : first + 2])} |" for first in range(0, len(films), 2)]
    gallery = "\n".join(["| | |", "|---|---|", *pairs])
    commands = "\n".join(card["command"] for card in cards.values())
    return PAGE.format(table=table, gallery=gallery, commands=commands)


def _result(told: dict[str, Any]) -> str:
    rate = told["success_rate"]
    if rate is None:
        return f"return {told['mean_return'] / told['mean_length']:.3f} a step"
    return f"{100 * rate:.1f} %"


def command(run: Run) -> str:
    """The command that makes such a run."""
    config = run.config
    words = ["python", "-m", "trocar.rl", "train", "--task", config.task, "--algo", config.algo]
    words += ["--seed", str(run.seed)]
    for flag, values in (("--set", changes(config)), ("--option", config.task_options)):
        for name, value in values.items():
            words += [flag, assignment(name, value)]
    return shlex.join(words)
