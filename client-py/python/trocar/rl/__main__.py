"""``python -m trocar.rl``: train, evaluate, table, curves, report, export, best, configs."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from trocar._assignments import SYNTAX, assignments
from trocar._paths import Parser, output_file_in_folder, output_folder
from trocar.errors import NoServer, TrocarError
from trocar.registration import TASKS, register_all
from trocar.rl.config import ALGORITHMS, load

EPILOG = """\
exit codes: 0 done, 1 failure, 2 wrong usage, 3 no server of that name
"""


def main(arguments: list[str] | None = None) -> int:
    """Runs a command and returns its exit code."""
    given = _parser().parse_args(arguments)
    try:
        if getattr(given, "server", None):
            # A server may have tasks of its own.
            register_all(given.server)
        given.run(given)
    except KeyboardInterrupt:
        print("interrupted; the same command with --resume goes on", file=sys.stderr)
        return 1
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except (TrocarError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 3 if isinstance(error, NoServer) else 1
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = Parser(prog="python -m trocar.rl", epilog=EPILOG)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    train = commands.add_parser("train", help="train a policy")
    train.set_defaults(run=_train)
    _chosen(train)
    train.add_argument("--seed", type=int, default=0, help="seed of the run (%(default)s)")
    train.add_argument(
        "--out", type=output_folder, default="runs", help="folder of runs (%(default)s)"
    )
    train.add_argument("--resume", action="store_true", help="go on with a run that is there")
    train.add_argument("--demos", help="folder of a Minari data set, instead of the expert")
    train.add_argument("--epochs", type=int, help="number of epochs (the configuration's)")
    train.add_argument("--envs", type=int, help="environments at a time (the configuration's)")
    train.add_argument("--server", help="name of a running server; one of its own by default")
    train.add_argument("--threads", type=int, default=1, help="threads of PyTorch (%(default)s)")
    train.add_argument("--view", action="store_true", help="print the address of the viewer")

    _trust(train)

    evaluate = commands.add_parser("evaluate", help="how often a policy succeeds, as JSON")
    evaluate.set_defaults(run=_evaluate)
    _run(evaluate)
    evaluate.add_argument(
        "--episodes", type=int, default=200, help="number of episodes (%(default)s)"
    )
    evaluate.add_argument("--seed", type=int, help="seed of the first episode (2000000)")
    evaluate.add_argument(
        "--envs", type=int, default=50, help="most environments at a time (%(default)s)"
    )
    evaluate.add_argument("--server", help="name of a running server; one of its own by default")
    evaluate.add_argument(
        "--conditions", action="store_true", help="also late, disturbed, and at twice the rate"
    )
    _options(evaluate)
    _trust(evaluate)

    table = commands.add_parser("table", help="evaluations of several runs, as a Markdown table")
    table.set_defaults(run=_table)
    table.add_argument("evaluations", type=Path, help="lines that evaluate printed")

    curves = commands.add_parser("curves", help="the figure of all runs in a folder")
    curves.set_defaults(run=_curves)
    curves.add_argument("runs", type=Path, help="folder of runs")
    curves.add_argument(
        "--out",
        type=output_file_in_folder,
        default="curves.png",
        help=".png; .csv beside it (%(default)s)",
    )

    report = commands.add_parser("report", help="a page with tables and figures of all runs")
    report.set_defaults(run=_report)
    report.add_argument("runs", type=Path, help="folder of runs")
    report.add_argument(
        "--out", type=output_file_in_folder, default="RESULTS.md", help="the page (%(default)s)"
    )
    report.add_argument(
        "--pictures", type=output_folder, default=".", help="folder of the figures (%(default)s)"
    )

    export = commands.add_parser("export", help="a policy as ONNX, for trocar rollout")
    export.set_defaults(run=_export)
    _run(export)
    export.add_argument(
        "--out", type=output_file_in_folder, default="policy.onnx", help="the file (%(default)s)"
    )
    export.add_argument(
        "--card", action="store_true", help="write into the file how well it does, once evaluated"
    )

    _trust(export)

    best = commands.add_parser("best", help="each task's best policy as ONNX, and their page")
    best.set_defaults(run=_best)
    best.add_argument("runs", type=Path, help="folder of runs, which were evaluated")
    best.add_argument(
        "--out", type=output_folder, default="policies", help="folder of the files (%(default)s)"
    )

    _trust(best)

    configs = commands.add_parser("configs", help="show a configuration, as JSON")
    configs.set_defaults(run=lambda given: print(_config(given).to_json()))
    _chosen(configs)
    return parser


def _run(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "run_folder", type=Path, metavar="RUN", help="folder of a run, as train printed it"
    )
    parser.add_argument(
        "--policy",
        choices=("best", "last"),
        default="best",
        help="the best policy of the run by its scores, or the last one (%(default)s)",
    )


def _trust(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--trust",
        action="store_true",
        help="load files of Stable-Baselines3 (.zip, .pkl), which can run any code",
    )


def _chosen(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--task", required=True, help="e.g. NeedlePick")
    parser.add_argument("--algo", choices=ALGORITHMS, help="the best one known if not given")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="FIELD=VALUE",
        help="another value of the configuration, e.g. noise=0.1; may be repeated",
    )
    _options(parser)


def _options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--option",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help=f"an option of the task: {SYNTAX}; may be repeated",
    )


def _config(given: argparse.Namespace) -> Any:
    config = load(given.task, given.algo)
    changes = assignments(given.set, "--set")
    for name in ("epochs", "envs"):
        if getattr(given, name, None) is not None:
            changes[name] = getattr(given, name)
    options = config.task_options | assignments(given.option)
    return config.but(**changes, task_options=options)


def _train(given: argparse.Namespace) -> None:
    from trocar.rl.training import train

    run = train(
        _config(given),
        given.seed,
        out=given.out,
        resume=given.resume,
        demos=given.demos,
        server=given.server,
        threads=given.threads,
        view=given.view,
        trust=given.trust,
    )
    print(run.path)


def _evaluate(given: argparse.Namespace) -> None:
    import torch

    from trocar.rl.cards import AS_TRAINED, conditions
    from trocar.rl.evaluation import FINAL_SEED, evaluate
    from trocar.rl.runs import Run

    torch.set_num_threads(1)
    run = Run(given.run_folder, given.trust)
    config, policy = run.config, run.policy(given.policy)
    options = assignments(given.option)
    tested: dict[str | None, Any] = {None if options else AS_TRAINED: options}
    if given.conditions:
        tested.update(conditions(config))
    for condition, options in tested.items():
        told = {
            "task": config.task,
            "algo": config.algo,
            "run": str(run.path),
            "policy": given.policy,
            "trained_with": config.task_options,
            "condition": condition,
        }
        result = evaluate(
            policy,
            config,
            options,
            seed=FINAL_SEED if given.seed is None else given.seed,
            episodes=given.episodes,
            envs=given.envs,
            server=given.server,
        )
        run.add_evaluation(told | result)
        print(json.dumps(told | result))


def _table(given: argparse.Namespace) -> None:
    from trocar.rl.table import markdown, read

    print(markdown(read(given.evaluations)))


def _curves(given: argparse.Namespace) -> None:
    from trocar.rl.curves import curves, find, plot, write_table

    made = curves(find(given.runs))
    plot(made, given.out)
    write_table(made, given.out.with_suffix(".csv"))
    for curve in made:
        print(
            f"{curve.task:18} {curve.label:24} {curve.runs} seeds, "
            f"after {int(curve.epochs[-1])} epochs {curve.mean[-1]:.3f} ± {curve.std[-1]:.3f}",
            file=sys.stderr,
        )
    print(given.out)


def _report(given: argparse.Namespace) -> None:
    from trocar.rl.curves import find
    from trocar.rl.report import write

    write(find(given.runs), given.runs, given.out, given.pictures)
    print(given.out)


def _export(given: argparse.Namespace) -> None:
    from trocar.rl.cards import card
    from trocar.rl.export import export
    from trocar.rl.runs import Run

    run = Run(given.run_folder, given.trust)
    told = card(run, given.policy) if given.card else None
    print(export(run.policy(given.policy), run.config, given.out, told))


def _best(given: argparse.Namespace) -> None:
    from trocar.rl.cards import best, card, page
    from trocar.rl.curves import find
    from trocar.rl.export import card_of, export

    def path(task: str) -> Path:
        return Path(given.out / f"{task}.onnx")

    for run in best(find(given.runs)):
        task = run.config.task
        run = replace(run, trust=given.trust)
        print(export(run.policy("best"), run.config, path(task), card(run)))
    # Tasks without a run keep the policies that are there.
    cards = {task: card_of(path(task)) for task in TASKS if path(task).exists()}
    (given.out / "README.md").write_text(page(cards))


if __name__ == "__main__":
    sys.exit(main())
