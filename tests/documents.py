"""Checks the names and figures in the documents against the code; `make lint` runs it.

Names that the documents use must exist:

- flags of commands (`--episodes`) in the sources of the programs, or in FOREIGN_FLAGS,
- targets of `make` in the Makefile,
- metrics (`trocar_sessions`) in the server, without the suffix of a counter,
- names of types in backticks (`TaskSpec`), in the sources or in FOREIGN_TYPES,
- options `name=value` of `--option` and of `make_vec` rows in the registry of options.

Each figure of the README must stand in one of the pages to which the README links: pages own
figures, and the README quotes them. CHANGELOG is history, so it may use names that are gone.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

FENCE = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```$", re.MULTILINE | re.DOTALL)
CODE = re.compile(r"`([^`\n]+)`")
FLAG = re.compile(r"(?<![\w-])--([a-z][a-z0-9-]+)")
TARGET = re.compile(r"\bmake ((?:[a-z][a-z0-9-]*)(?: [a-z][a-z0-9-]+)*)")
METRIC = re.compile(r"\btrocar_[a-z_]+\b")
TYPE = re.compile(r"(?:[A-Z][a-z0-9]+){2,}")
OPTION = re.compile(r"--option '?([a-z_]+)=")
FIGURE = re.compile(
    r"(?<![\w.,/-])(\d{1,3}(?:,\d{3})+|\d+(?:\.\d+)? (?:%|s|steps/s)(?!\w)|\d+ of \d+)"
)

FOREIGN_FLAGS = frozenset(
    [
        "bench",
        "cpu-list",
        "example",
        "features",
        "force-reinstall",
        "ignored",
        "ipc",
        "lib",
        "locked",
        "logdir",
        "manifest-path",
        "nocapture",
        "no-deps",
        "no-index",
        "find-links",
        "package",
        "release",
        "shm-size",
        "skip-install",
        "test",
        "user",
        "vm",
        "version",
        "help",
        "exact",
        "cap-add",
        "net",
        "privileged",
        "rm",
        "volume",
        "env",
    ]
)
"""Flags of cargo, pip, Docker, taskset and maturin in the documents."""

FOREIGN_TYPES = frozenset(
    [
        "AsyncVectorEnv",
        "SubprocVecEnv",
        "HerReplayBuffer",
        "VecMonitor",
        "VecNormalize",
        "GymWrapper",
        "VecEnv",
        "SyncVectorEnv",
        "ReplayBuffer",
        "MultiInputPolicy",
        "LimitNOFILE",
        "RemoveIPC",
        "TinyRenderer",
    ]
)
"""Types of Gymnasium, Stable-Baselines3, TorchRL and settings of systemd."""


class Names:
    """The names that exist, read from the sources."""

    def __init__(self, root: Path) -> None:
        files = subprocess.run(
            ["git", "ls-files", "*.rs", "*.py", "*.pyi", "*.js", "*.ts", "*.toml", "*.sh", ".ci/*"],
            cwd=root,
            check=True,
            capture_output=True,
            text=True,
        ).stdout.split()
        skipped = (Path(__file__).name, "test_documents.py")
        paths = [root / file for file in files if Path(file).name not in skipped]
        self.source = "\n".join(path.read_text() for path in paths if path.exists())
        self.words = frozenset(re.findall(r"\w+", self.source))
        makefile = (root / "Makefile").read_text()
        self.targets = frozenset(re.findall(r"^([a-z][a-z0-9-]*):", makefile, re.MULTILINE))
        self.flags = frozenset(FLAG.findall(self.source + makefile)) | FOREIGN_FLAGS

    def has_flag(self, flag: str) -> bool:
        """True for a flag that a source writes out, or derives from a field of that name."""
        return flag in self.flags or flag.replace("-", "_") in self.words

    def has_metric(self, metric: str) -> bool:
        """True for a metric, or a crate, of that name; counters end in `_total`."""
        name = metric.removeprefix("trocar_").removesuffix("_total")
        return metric in self.words or f'"{name}"' in self.source

    def has_type(self, name: str) -> bool:
        """True for a type, a variant or a class in the sources or in FOREIGN_TYPES."""
        return name in self.words or name in FOREIGN_TYPES


def code_of(text: str) -> Iterator[tuple[int, str]]:
    """Code in blocks and in backticks, with its line number."""
    for block in FENCE.finditer(text):
        first = text.count("\n", 0, block.start()) + 2
        for number, line in enumerate(block[2].splitlines()):
            yield first + number, line
    plain = FENCE.sub(lambda block: "\n" * block[0].count("\n"), text)
    for span in CODE.finditer(plain):
        yield plain.count("\n", 0, span.start()) + 1, span[1]


def offences(text: str, names: Names) -> Iterator[str]:
    """Names of a document that do not exist, as `line: kind name`."""
    for line, code in code_of(text):
        for flag in FLAG.findall(code):
            if not names.has_flag(flag):
                yield f"{line}: no flag --{flag}"
        for option in OPTION.findall(code):
            if f'"{option}"' not in names.source:
                yield f"{line}: no option {option}"
        for targets in TARGET.findall(code):
            for target in targets.split():
                if code.startswith("make") and target not in names.targets:
                    yield f"{line}: no target {target} of make"
        for metric in METRIC.findall(code):
            if not names.has_metric(metric):
                yield f"{line}: no metric {metric}"
        if TYPE.fullmatch(code) and not names.has_type(code):
            yield f"{line}: no type {code}"


def unowned_figures(readme: str, pages: str) -> Iterator[str]:
    """Figures of the README that no linked page has."""
    prose = FENCE.sub(lambda block: "\n" * block[0].count("\n"), readme)
    for figure in FIGURE.finditer(prose):
        if figure[1] not in pages:
            line = prose.count("\n", 0, figure.start()) + 1
            yield f"{line}: the figure {figure[1]} stands in no linked page"


def linked_pages(readme: Path) -> str:
    """Texts of the pages to which the README links."""
    targets = re.findall(r"\]\(([^)\s#]+\.md)", readme.read_text())
    return "\n".join((readme.parent / target).read_text() for target in sorted(set(targets)))


def main() -> int:
    """Prints each offence with its document; 1 if there are any."""
    names = Names(ROOT)
    listed = subprocess.run(
        ["git", "ls-files", "*.md"], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout.split()
    found = [
        f"{path}:{offence}"
        for path in listed
        if path != "CHANGELOG.md" and (ROOT / path).exists()
        for offence in offences((ROOT / path).read_text(), names)
    ]
    readme = ROOT / "README.md"
    found += [
        f"README.md:{offence}"
        for offence in unowned_figures(readme.read_text(), linked_pages(readme))
    ]
    print("\n".join(found), file=sys.stderr, end="\n" if found else "")
    return 1 if found else 0


if __name__ == "__main__":
    raise SystemExit(main())
