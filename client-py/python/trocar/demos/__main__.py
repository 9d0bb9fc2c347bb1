"""``python -m trocar.demos``: what ``trocar demos`` runs."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict
from typing import Any

from trocar._paths import Parser, output_folder
from trocar.demos import FORMATS, Recording, record
from trocar.errors import InvalidRequest, NoServer, TrocarError
from trocar.registration import register_all


def main(arguments: list[str] | None = None) -> int:
    """Records, prints a JSON line, and returns the exit code of ``trocar``."""
    given = parser().parse_args(arguments)
    try:
        recording = _record(given)
    except KeyboardInterrupt:
        print("interrupted; --resume goes on", file=sys.stderr)
        return 1
    except (InvalidRequest, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except NoServer as error:
        print(f"error: {error}", file=sys.stderr)
        return 3
    except (TrocarError, ImportError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    if given.json:
        print(json.dumps(asdict(recording)))
    else:
        kept = f"{recording.kept} of {recording.episodes} episodes kept"
        print(f"{recording.task}: {kept} in {recording.path}", file=sys.stderr)
    return 0


def parser() -> argparse.ArgumentParser:
    """The flags, as those of ``trocar demos``."""
    parser = Parser(prog="python -m trocar.demos", description=__doc__)
    parser.add_argument("--task", required=True)
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--out", type=output_folder, default="demos")
    parser.add_argument("--name", default=None)
    parser.add_argument("--format", choices=FORMATS, default="minari")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--envs", type=int, default=16)
    parser.add_argument("--keep-failures", action="store_true")
    parser.add_argument("--by-hand", action="store_true")
    parser.add_argument("--speed", type=float, default=1.0)
    parser.add_argument("--max-steps", type=int, default=None)
    parser.add_argument("--resume", action="store_true")
    parser.add_argument("--server", default=None)
    parser.add_argument("--options", type=json.loads, default={}, help="options as a JSON object")
    parser.add_argument("--json", action="store_true")
    return parser


def _record(given: argparse.Namespace) -> Recording:
    names = (
        *("episodes", "out", "name", "format", "seed", "keep_failures", "envs", "resume"),
        *("speed", "max_steps"),
    )
    settings: dict[str, Any] = {name: getattr(given, name) for name in names}
    settings |= {"server": given.server, **given.options}
    settings["name"] = given.name or ("hand-v0" if given.by_hand else "expert-v0")
    if given.server:
        # A server may have tasks of its own.
        register_all(given.server)
    if given.by_hand:
        settings["by_hand"] = lambda page: print(f"drive at {page}", file=sys.stderr, flush=True)
    if not sys.stderr.isatty():
        return record(given.task, **settings)
    from tqdm import tqdm

    with tqdm(total=given.episodes, desc=given.task, unit="episode") as bar:

        def progress(done: int, kept: int) -> None:
            bar.set_postfix(kept=kept)
            bar.update(done - bar.n)

        return record(given.task, progress=progress, **settings)


if __name__ == "__main__":
    sys.exit(main())
