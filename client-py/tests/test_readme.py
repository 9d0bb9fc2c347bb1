"""The documents keep their word: code runs as a reader would paste it, links lead somewhere."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
OTHERS = [ROOT / f"{name}.md" for name in ("ARCHITECTURE", "CHANGELOG", "CONTRIBUTING", "SECURITY")]
DOCUMENTS = [README, *sorted((ROOT / "docs").glob("*.md")), *OTHERS]

LARGEST = 10_000
"""Most bytes of the README: what a newcomer reads in a few minutes."""

FENCED = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)


def name(path: Path) -> str:
    return str(path.relative_to(ROOT))


def python_blocks() -> list[object]:
    """Every block of Python that can be run, with its document's name."""
    return [
        pytest.param(block, id=f"{name(path)}-{index}")
        for path in DOCUMENTS
        for index, block in enumerate(
            re.findall(r"^```python\n(.*?)^```$", path.read_text(), re.MULTILINE | re.DOTALL)
        )
    ]


def links(path: Path) -> list[str]:
    """Targets of a document's links and pictures, less those on the web."""
    prose = FENCED.sub("", path.read_text())
    targets = re.findall(r"\]\(([^)\s]+)\)", re.sub(r"`[^`\n]*`", "", prose))
    return [target for target in targets if not re.match(r"[a-z]+:", target)]


def anchors(path: Path) -> set[str]:
    """What a document's headings are called in links, as GitHub has it."""
    headings = re.findall(r"^#+ (.*)$", FENCED.sub("", path.read_text()), re.MULTILINE)
    plain = [re.sub(r"[^\w\- ]", "", heading.lower()) for heading in headings]
    return {heading.replace(" ", "-") for heading in plain}


def test_the_readme_has_a_quick_start_and_is_short() -> None:
    text = README.read_text()
    assert "```python\n" in text
    assert len(text.encode()) <= LARGEST


@pytest.mark.parametrize("path", DOCUMENTS, ids=name)
def test_links_lead_to_files_and_headings(path: Path) -> None:
    for target in links(path):
        file, _, heading = target.partition("#")
        there = (path.parent / file).resolve() if file else path
        assert there.exists(), f"{name(path)} links to {target}"
        assert there.is_relative_to(ROOT), f"{name(path)} links to {target}"
        if heading:
            assert heading in anchors(there), f"{name(path)} links to {target}"


def test_every_document_is_reached_from_the_readme() -> None:
    reached = [README]
    for path in reached:
        targets = {(path.parent / target.partition("#")[0]).resolve() for target in links(path)}
        reached += sorted(targets.intersection(DOCUMENTS).difference(reached))
    assert set(DOCUMENTS) <= set(reached)


@pytest.mark.parametrize("block", python_blocks())
def test_blocks_run_as_pasted(block: str, tmp_path: Path) -> None:
    path = tmp_path / "pasted.py"
    path.write_text(block)
    done = subprocess.run(
        [sys.executable, "-W", "error", str(path)],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    printed = re.findall(r"print\(.*\)  # (.*)$", block, re.MULTILINE)
    assert done.stdout.split("\n")[-len(printed) - 1 : -1] == printed or not printed
