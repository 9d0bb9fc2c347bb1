"""Looks for names that stand for something the field has another word for: `make lint` runs it.

Types, functions, fields, modules, files and metrics are looked at, in Rust and Python.
ARCHITECTURE.md's glossary has the words that stay.
"""

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

INSTEAD = {
    "door": "doorbell",
    "bell": "event count, reply event",
    "vigil": "spin wait",
    "woken": "wait outcome",
    "mapping": "shm",
    "hall": "scheduler",
    "seat": "slot",
    "guest": "runnable session",
    "attend": "poll",
    "visit": "running",
    "turn": "quantum",
    "turns": "run queue",
    "grant": "permit",
    "beckon": "kick",
    "patrol": "scan",
    "pile": "work queue",
    "bite": "chunk",
    "divisible": "splittable",
    "deed": "batch command",
    "ground": "server context",
    "account": "client quota",
    "course": "session stats",
    "desk": "admission",
    "judge": "check",
    "host": "session registry",
    "lease": "liveness",
    "census": "live nodes",
    "gallery": "watch registry",
    "exhibit": "registration",
    "tap": "subscription",
    "window": "frame channel",
    "teller": "scene encoder",
    "painter": "camera worker",
    "reel": "replay source",
    "witness": "step observer",
    "tape": "live recording",
    "travel": "motion",
    "furniture": "static bodies",
    "tie": "attachment",
    "calm": "resting",
    "oracle": "expert",
}

ORDINARY = {
    # A recorded episode, or what is to happen to a client of `trocar load`.
    "course": {"course", "Course"},
    "door": {"test_front_door"},
    # The pictures of all policies.
    "gallery": {"gallery"},
    # What a picture's light comes back from.
    "ground": {"ground"},
    # Rotations.
    "turn": {
        *("turn", "Turn", "back_turn", "half_turn", "nearest_turn", "turn_hinged"),
        *("HALF_TURN", "STEP_TURN", "STILL_TURN"),
    },
    "turns": {"turns"},
    # How far a spring gives way.
    "travel": {"travel"},
    # A step of a search through a graph.
    "visit": {"visit"},
    # On a screen, or of time.
    "window": {"_window", "Window", "window"},
}
"""Names with such a word in its everyday meaning."""

SENTENCE = 4
"""A name with more words is a sentence, as tests have: the words in it are prose."""

RUST = re.compile(
    r"\b(?:struct|enum|trait|type|fn|mod|const|static|union)\s+(\w+)"
    r"|^\s*(?:pub(?:\([^)]*\))?\s+)?(\w+)\s*:(?!:)\s*[A-Z&\[(<a-z]"
)
PYTHON = re.compile(r"^\s*(?:async\s+)?(?:def|class)\s+(\w+)|^\s*(\w+)\s*(?::[^=]+)?=[^=]")
METRIC = re.compile(r'\b(?:register|add)\w*\(\s*"(\w+)"')


def parts(name: str) -> list[str]:
    """The words of a name."""
    spaced = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name)
    return [word.lower() for word in spaced.split("_") if word]


def names(path: Path, text: str) -> Iterator[tuple[int, str]]:
    """The names that a file declares, by line; its own is in line 0."""
    yield 0, path.stem
    patterns = [RUST, METRIC] if path.suffix == ".rs" else [PYTHON]
    for number, line in enumerate(text.splitlines(), 1):
        code = line.split("//")[0] if path.suffix == ".rs" else line.split("#")[0]
        for pattern in patterns:
            for found in pattern.finditer(code):
                yield number, next(group for group in found.groups() if group)


def main() -> int:
    """Prints what it finds; 1 if that is anything."""
    listed = subprocess.run(
        ["git", "ls-files", "*.rs", "*.py"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    found = []
    used = set()
    for file in listed.stdout.split():
        path = ROOT / file
        for number, name in names(Path(file), path.read_text()):
            words = parts(name)
            for word in words if len(words) <= SENTENCE else ():
                if word not in INSTEAD:
                    continue
                if name in ORDINARY.get(word, ()):
                    used.add((word, name))
                else:
                    found.append(f"{file}:{number}: {name}: for {word!r} write {INSTEAD[word]!r}")
    stale = [
        f"{__file__}: {name} is nowhere any more"
        for word, ordinary in ORDINARY.items()
        for name in sorted(ordinary)
        if (word, name) not in used
    ]
    print(*dict.fromkeys(found), *stale, sep="\n")
    return 1 if found or stale else 0


if __name__ == "__main__":
    sys.exit(main())
