"""``python -m trocar.rl``: train, evaluate, table, curves, export, configs."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from trocar.errors import InvalidOption, NoServer, TrocarError, refuse
from trocar.rl.config import ALGORITHMS, load

EPILOG = """\
exit codes: 0 done, 1 failure, 2 wrong usage, 3 no server of that name
"""


def main(arguments: list[str] | None = None) -> int:
    """Runs a command and returns its exit code."""
    given = _parser().parse_args(arguments)
    try:
        given.run(given)
    except KeyboardInterrupt:
        print("interrupted; --resume goes on", file=sys.stderr)
        return 1
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except (TrocarError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 3 if isinstance(error, NoServer) else 1
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m trocar.rl", epilog=EPILOG)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    train = commands.add_parser("train", help="train a policy")
    train.set_defaults(run=_train)
    _chosen(train)
    train.add_argument("--seed", type=int, default=0)
    train.add_argument("--out", default="runs", help="folder of runs")
    train.add_argument("--resume", action="store_true", help="go on with a run that is there")
    train.add_argument("--demos", help="folder of a Minari data set, instead of the expert")
    train.add_argument("--epochs", type=int)
    train.add_argument("--envs", type=int)
    train.add_argument("--server", help="name of a running server; one of its own by default")
    train.add_argument("--threads", type=int, default=1, help="of PyTorch")

    evaluate = commands.add_parser("evaluate", help="how often a policy succeeds, as JSON")
    evaluate.set_defaults(run=_evaluate)
    evaluate.add_argument("run_folder", type=Path, metavar="RUN")
    evaluate.add_argument("--policy", choices=("best", "last"), default="best")
    evaluate.add_argument("--episodes", type=int, default=200)
    evaluate.add_argument("--seed", type=int, help="of the first episode")
    evaluate.add_argument("--envs", type=int, default=50)
    evaluate.add_argument("--server")
    _options(evaluate)

    table = commands.add_parser("table", help="evaluations of several runs, as a Markdown table")
    table.set_defaults(run=_table)
    table.add_argument("evaluations", type=Path, help="lines that evaluate printed")

    curves = commands.add_parser("curves", help="the figure of all runs in a folder")
    curves.set_defaults(run=_curves)
    curves.add_argument("runs", type=Path)
    curves.add_argument("--out", type=Path, default=Path("curves.png"), help=".png; .csv beside it")

    export = commands.add_parser("export", help="a policy as ONNX, for trocar rollout")
    export.set_defaults(run=_export)
    export.add_argument("run_folder", type=Path, metavar="RUN")
    export.add_argument("--policy", choices=("best", "last"), default="best")
    export.add_argument("--out", type=Path, default=Path("policy.onnx"))

    configs = commands.add_parser("configs", help="show a configuration, as JSON")
    configs.set_defaults(run=lambda given: print(_config(given).to_json()))
    _chosen(configs)
    return parser


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
        help="an option of the task, e.g. grasp=approx; may be repeated",
    )


def _values(assignments: list[str]) -> dict[str, Any]:
    """Values by name; what is no JSON is a word."""
    values: dict[str, Any] = {}
    for assignment in assignments:
        name, equals, text = assignment.partition("=")
        if not equals:
            raise refuse(InvalidOption, "assignment", assignment, "expected NAME=VALUE")
        try:
            values[name] = json.loads(text)
        except ValueError:
            values[name] = text
    return values


def _config(given: argparse.Namespace) -> Any:
    config = load(given.task, given.algo)
    changes = _values(given.set)
    for name in ("epochs", "envs"):
        if getattr(given, name, None) is not None:
            changes[name] = getattr(given, name)
    options = config.task_options | _values(given.option)
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
    )
    print(run.path)


def _evaluate(given: argparse.Namespace) -> None:
    import torch

    from trocar.rl.evaluation import FINAL_SEED, score
    from trocar.rl.runs import Run
    from trocar.sb3 import make_vec

    torch.set_num_threads(1)
    run = Run(given.run_folder)
    config = run.config
    options = config.options | _values(given.option)
    seed = FINAL_SEED if given.seed is None else given.seed
    policy = run.policy(given.policy)
    count = min(given.envs, given.episodes)
    envs = make_vec(config.task_id, count, server=given.server, **options)
    try:
        result = score(policy, envs, seed, given.episodes)
    finally:
        envs.close()
    low, high = result.interval
    has_goals = envs.envs.task_spec.goal is not None
    print(
        json.dumps(
            {
                "task": config.task,
                "algo": config.algo,
                "run": str(run.path),
                "policy": given.policy,
                "trained_with": config.task_options,
                "options": options,
                "seed": seed,
                "episodes": result.episodes,
                "success_rate": result.success_rate if has_goals else None,
                "confidence_95": [low, high] if has_goals else None,
                "success_ever_rate": result.successes_ever / result.episodes if has_goals else None,
                "mean_return": result.mean_return,
                "mean_length": result.mean_length,
            }
        )
    )


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


def _export(given: argparse.Namespace) -> None:
    from trocar.rl.export import export
    from trocar.rl.runs import Run

    run = Run(given.run_folder)
    print(export(run.policy(given.policy), run.config, given.out))


if __name__ == "__main__":
    sys.exit(main())
