"""``python -m trocar.dvrk script.py``: runs a script for a real da Vinci in a simulated world.

The names ``crtk``, ``dvrk`` and, where there is none, ``PyKDL`` are put in place for this process
only. So is the script's clock: ``time.sleep`` lets the world's time pass, ``time.time`` tells it.
In lock-step, other clocks and waits of Python do so as well: see :mod:`trocar.dvrk._clock`.
"""

from __future__ import annotations

import argparse
import contextlib
import runpy
import signal
import sys
import time
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from trocar import dvrk
from trocar._paths import output_file
from trocar.dvrk import arms, crtk, kdl
from trocar.dvrk._clock import Clock
from trocar.errors import TrocarError


def put_in_place(world: dvrk.World) -> None:
    """Lets scripts import what they import on a real robot."""
    dvrk.use(world)
    modules: dict[str, Any] = {"crtk": crtk, "dvrk": types.ModuleType("dvrk", arms.__doc__)}
    for name in arms.__all__:
        member = getattr(arms, name)
        setattr(modules["dvrk"], name, member)
        # `from dvrk.psm import psm` works as well, and leaves `dvrk.psm` the class.
        below = types.ModuleType(f"dvrk.{name}")
        setattr(below, name, member)
        modules[f"dvrk.{name}"] = below
    modules["dvrk"].__path__ = []
    # `crtk.utils` is a module of the package and the class of that name, as in CRTK's client.
    modules["crtk"].__path__ = []
    modules["crtk.utils"] = types.ModuleType("crtk.utils", crtk.utils.__doc__)
    modules["crtk.utils"].utils = crtk.utils
    try:
        import PyKDL  # noqa: F401
    except ImportError:
        modules["PyKDL"] = kdl
    sys.modules.update(modules)


@contextlib.contextmanager
def clock_in_place(world: dvrk.World, is_lock_step: bool) -> Iterator[None]:
    """Puts the world's clock in the place of Python's."""
    if is_lock_step:
        world.clock = Clock(world)
        with world.clock.in_place():
            yield
        return
    kept = (time.sleep, time.time)
    time.sleep = world.sleep  # type: ignore[assignment]
    time.time = world.now
    try:
        yield
    finally:
        time.sleep, time.time = kept


def recording(text: str) -> Path:
    """Path of a recording, if a file can be written there; the script may change the folder."""
    return output_file(text).absolute()


def is_script(path: Path) -> bool:
    """True for the paths that :func:`runpy.run_path` runs."""
    return (path / "__main__.py").is_file() if path.is_dir() else path.exists()


def terminate(number: int, _: object) -> None:
    """Ends the script on a signal, with the shell's exit status for that signal."""
    raise SystemExit(128 + number)


def speed(text: str) -> float | None:
    """A speed, or ``max`` for lock-step."""
    return None if text == "max" else float(text)


def arguments() -> argparse.Namespace:
    """What the command line says."""
    parser = argparse.ArgumentParser(prog="python -m trocar.dvrk", description=__doc__)
    parser.add_argument("--server", help="name of a running server (default: a private one)")
    parser.add_argument("--task", default="NeedlePick-v0", help="whose world it is (%(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="which episode it is (%(default)s)")
    parser.add_argument(
        "--speed",
        type=speed,
        default=None,
        help="times real time, or max: as fast as it goes, in lock-step (max)",
    )
    parser.add_argument(
        "--homing",
        choices=["to_zero", "in_place"],
        default="to_zero",
        help="whether arms move when they are homed (%(default)s)",
    )
    parser.add_argument(
        "--errors",
        metavar="PRESET",
        help="errors of real arms: a preset of the task's option domain, such as dvrk (none)",
    )
    parser.add_argument(
        "--world",
        type=int,
        metavar="SESSION",
        help="share the world of this session, as `trocar status` numbers them",
    )
    parser.add_argument(
        "--frames",
        choices=["rcm", "world"],
        default="rcm",
        help="frame of the arms' poses: each remote centre's, or the world's (%(default)s)",
    )
    parser.add_argument(
        "--record",
        type=recording,
        metavar="FILE.trocar",
        help="write what was done, for `trocar replay`",
    )
    parser.add_argument("--quiet", action="store_true", help="do not print warnings of arms")
    parser.add_argument("script", help="the script")
    parser.add_argument("args", nargs=argparse.REMAINDER, help="its arguments")
    return parser.parse_args()


def main() -> None:
    """Opens a world, and runs the script in it."""
    given = arguments()

    def complain(arm: str, words: str) -> None:
        if not given.quiet:
            print(f"{arm}: {words}", file=sys.stderr)

    if not is_script(Path(given.script)):
        sys.exit(
            f"trocar.dvrk: script = {given.script!r}: expected a Python file, or a folder with "
            "__main__.py"
        )
    try:
        world = dvrk.World(
            given.task,
            server=given.server,
            seed=given.seed,
            options={"domain": {"preset": given.errors}} if given.errors else None,
            speed=given.speed,
            homing=given.homing,
            world=given.world,
            in_world=given.frames == "world",
            complain=complain,
        )
    except TrocarError as error:
        sys.exit(f"trocar.dvrk: {error}")
    put_in_place(world)
    sys.argv = [given.script, *given.args]
    # A folder or an archive is added by `run_path`.
    if Path(given.script).is_file() and not getattr(sys.flags, "safe_path", False):
        sys.path.insert(0, str(Path(given.script).resolve().parent))
    # SIGTERM is to write the recording, as Ctrl-C does.
    signal.signal(signal.SIGTERM, terminate)
    try:
        with clock_in_place(world, given.speed is None):
            runpy.run_path(given.script, run_name="__main__")
    finally:
        dvrk.use(None)
        if given.record:
            given.record.write_bytes(world.live.recording())
        world.close()


if __name__ == "__main__":
    main()
