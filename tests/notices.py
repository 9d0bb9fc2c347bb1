"""Writes the third-party notices of the wheels, and checks that wheels have them.

``python3 tests/notices.py write`` writes THIRD_PARTY_NOTICES and LICENSE beside the pyproject.toml
of both wheels; ``check WHEEL…`` compares wheels with the dependency trees. `make wheels` runs both.

A notice has the licence, authors and source of a work, and the numbers of its licence texts, which
follow below and stand in the file once. Works are the crates of the dependency tree as `cargo
metadata --locked` resolves it for this machine, Rust's standard library, scripts in the viewer's
page, and the policies inside the program. A crate without a licence file gets the text of the
Apache licence, if its manifest offers that licence.
"""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parent.parent
NAME = "THIRD_PARTY_NOTICES"
LICENCE_FILE = re.compile(r"(un)?licen[cs]e|copying|copyright|notice|patents", re.IGNORECASE)
NO_TEXT = frozenset([".rs", ".toml", ".json", ".yml", ".yaml", ".py", ".sh", ".html"])


class Wheel(NamedTuple):
    """A wheel: its name in file names, its crate, and the folder of its pyproject.toml."""

    name: str
    crate: str
    folder: str


WHEELS = (
    Wheel("trocar", "trocar-py", "client-py"),
    Wheel("trocar_server", "trocar", "server/cli"),
)


class Work(NamedTuple):
    """A work that a wheel contains."""

    title: str
    licence: str
    authors: str
    source: str
    texts: tuple[str, ...]


def metadata() -> dict[str, Any]:
    """The packages of the workspace and of its dependencies."""
    platform = output("rustc", "--print", "host-tuple").strip()
    command = ("cargo", "metadata", "--locked", "--format-version=1", "--filter-platform")
    found: dict[str, Any] = json.loads(output(*command, platform))
    return found


def output(*command: str) -> str:
    """Standard output of a command."""
    return subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True).stdout


def crates(found: dict[str, Any], crate: str) -> list[dict[str, Any]]:
    """The foreign crates below a crate of the workspace, without those of builds and tests."""
    packages = {package["id"]: package for package in found["packages"]}
    nodes = {node["id"]: node for node in found["resolve"]["nodes"]}
    own = (package for package in packages.values() if package["source"] is None)
    waiting = [package["id"] for package in own if package["name"] == crate]
    seen: set[str] = set()
    while waiting:
        current = waiting.pop()
        if current not in seen:
            seen.add(current)
            waiting += [
                dependency["pkg"]
                for dependency in nodes[current]["deps"]
                if any(kind["kind"] is None for kind in dependency["dep_kinds"])
            ]
    foreign = (packages[key] for key in seen if packages[key]["source"] is not None)
    return sorted(foreign, key=lambda package: (package["name"], package["version"]))


def normalised(text: str) -> str:
    """A text without trailing blanks, so that copies of one text are equal."""
    return "\n".join(line.rstrip() for line in text.splitlines()).strip("\n")


def apache() -> str:
    """The Apache licence, version 2.0."""
    return normalised((ROOT / "LICENSE").read_text())


def licence_texts(package: dict[str, Any]) -> tuple[str, ...]:
    """The licence texts of a crate."""
    folder = Path(package["manifest_path"]).parent
    files = [path for path in folder.iterdir() if LICENCE_FILE.search(path.name)]
    files += [inner for path in files if path.is_dir() for inner in path.iterdir()]
    files = sorted(path for path in files if path.is_file() and path.suffix not in NO_TEXT)
    texts = [normalised(path.read_text(errors="replace")) for path in files]
    texts = list(dict.fromkeys(text for text in texts if text))
    if not texts and "Apache-2.0" in (package["license"] or ""):
        texts = [apache()]
    if not texts:
        title = f"{package['name']} {package['version']}"
        sys.exit(f"{title} ({package['license']}) has no licence text")
    return tuple(texts)


def of_crate(package: dict[str, Any]) -> Work:
    """The notice of a crate."""
    return Work(
        f"{package['name']} {package['version']}",
        package["license"] or "see the text",
        ", ".join(package["authors"]),
        package["repository"] or f"crate {package['name']}",
        licence_texts(package),
    )


def standard_library() -> Work:
    """The notice of Rust's standard library, which programs contain."""
    path = Path(
        output("rustc", "--print", "sysroot").strip(), "share/doc/rust/COPYRIGHT-library.html"
    )
    texts = [html.unescape(re.sub(r"<[^>]*>", "", path.read_text()))] if path.exists() else []
    return Work(
        f"Rust standard library {output('rustc', '--version').split()[1]}",
        "MIT OR Apache-2.0",
        "The Rust Project contributors",
        "https://github.com/rust-lang/rust",
        (*map(normalised, texts), apache()),
    )


def scripts() -> Work:
    """The notice of three.js, which the viewer's page contains."""
    page = (ROOT / "server/view/page.html").read_text()
    found = re.search(r"It contains three\.js (\S+):\n\n(.*?)-->", page, re.DOTALL)
    assert found, "the page begins with the licence of three.js"
    version, text = found.groups()
    source = "https://github.com/mrdoob/three.js"
    return Work(f"three.js {version}", "MIT", "three.js authors", source, (normalised(text),))


def policies() -> Work:
    """The notice of the policies inside the program."""
    text = normalised((ROOT / "assets/DATA_LICENSE.md").read_text())
    return Work("policies of Trocar", "CC BY 4.0", "Trocar's authors", "assets/policies", (text,))


def works(found: dict[str, Any], wheel: Wheel) -> list[Work]:
    """All works that a wheel contains."""
    listed = [of_crate(package) for package in crates(found, wheel.crate)]
    listed.append(standard_library())
    return [*listed, scripts(), policies()] if wheel.crate == "trocar" else listed


def notices(wheel: Wheel, listed: Iterable[Work]) -> str:
    """The text of the file."""
    numbers: dict[str, int] = {}
    lines = [f"Works that the wheel {wheel.name} contains, and their licences", ""]
    for work in listed:
        refer = [numbers.setdefault(text, len(numbers) + 1) for text in work.texts]
        lines += [
            work.title,
            f"  licence: {work.licence}",
            *([f"  authors: {work.authors}"] if work.authors else []),
            f"  source: {work.source}",
            f"  texts: {', '.join(map(str, refer))}",
            "",
        ]
    for text, number in numbers.items():
        lines += [heading(number), "", text, ""]
    return "\n".join(lines)


def heading(number: int) -> str:
    """The heading of a licence text."""
    return f"======== Text {number} ========"


def missing(listed: Iterable[Work], text: str) -> list[str]:
    """The works that have no notice in a file, or a notice without licence text."""
    notice = re.compile(
        r"^(\S.*)\n  licence: .+\n(?:  authors: .+\n)?  source: .+\n  texts: (.+)$", re.M
    )
    found = {title: numbers.split(", ") for title, numbers in notice.findall(text)}
    return [
        work.title
        for work in listed
        if not found.get(work.title)
        or not all(
            f"{heading(int(number))}\n\n{body}" in text
            for number, body in zip(found[work.title], work.texts, strict=False)
        )
    ]


def check(found: dict[str, Any], path: Path) -> list[str]:
    """The faults of a wheel."""
    wheel = next(wheel for wheel in WHEELS if path.name.startswith(f"{wheel.name}-"))
    with zipfile.ZipFile(path) as file:
        files = {Path(name).name: name for name in file.namelist() if "/licenses/" in name}
        lacking = [f"{path.name} has no {name}" for name in (NAME, "LICENSE") if name not in files]
        if lacking:
            return lacking
        text = file.read(files[NAME]).decode()
    return [f"{path.name}: no notice of {title}" for title in missing(works(found, wheel), text)]


def main(arguments: list[str]) -> int:
    """Writes or checks; the exit status."""
    if arguments[:1] not in (["write"], ["check"]):
        print(__doc__, file=sys.stderr)
        return 2
    found = metadata()
    if arguments[0] == "write":
        for wheel in WHEELS:
            # Files of a wheel must lie beside its pyproject.toml.
            shutil.copy(ROOT / "LICENSE", ROOT / wheel.folder / "LICENSE")
            path = ROOT / wheel.folder / NAME
            path.write_text(notices(wheel, works(found, wheel)))
            print(f"{path.relative_to(ROOT)}: {path.stat().st_size} bytes", file=sys.stderr)
        return 0
    faults = [fault for path in arguments[1:] for fault in check(found, Path(path))]
    print("\n".join(faults), file=sys.stderr, end="\n" if faults else "")
    return int(bool(faults))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
