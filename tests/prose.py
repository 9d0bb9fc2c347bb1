"""Measures how the documents and comments of this repository read; `make lint` runs it.

Three measures, each with a bar:

- the share of long sentences in the documents (README, ARCHITECTURE, `docs/` and the like),
- how often `who` and its forms stand where a noun would name the actor,
- how often `somebody`, `nobody` and the like do.

Sentences end at full stops and with list items. Code in blocks, tables and addresses do not count;
code inside a sentence counts as one word. `--list` prints every offence, not only those above a
bar.
"""

from __future__ import annotations

import io
import re
import subprocess
import sys
import tokenize
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

LONG = 35  # words that a sentence may have
LONG_SHARE = 0.02  # of the sentences of documents
WHO_RATE = 0.6  # per 1,000 words
SOMEBODY_RATE = 0.1

WHO = re.compile(r"\b(who|whom|whoever|whomever)\b", re.IGNORECASE)
SOMEBODY = re.compile(r"\b((some|no|any)body|someone|anyone|no one)\b", re.IGNORECASE)

FENCE = re.compile(r"^\s*(```|~~~)")
NO_PROSE = re.compile(r"^\s*(\||<|!\[|#!|SPDX)")  # tables, HTML, pictures
ITEM = re.compile(r"^\s*([-*+]|\d+\.)\s+")
HEADING = re.compile(r"^#+\s")
CODE = re.compile(r"`+[^`]*`+")
LINK = re.compile(r"\[([^][]*)\](\([^)]*\)|\[[^]]*\])")
ADDRESS = re.compile(r"<?\bhttps?://\S+")
FULL_STOP = re.compile(r"(?<=[.!?])[)\"'*_]*\s+")
RUST_COMMENT = re.compile(r"(?:^|\s)//[/!]?(?:\s(.*))?$")


class Line(NamedTuple):
    """A line of prose and its number in the file."""

    number: int
    text: str


class Sentence(NamedTuple):
    """A sentence and where it begins."""

    path: str
    line: int
    text: str

    @property
    def words(self) -> int:
        """How many words it has."""
        return sum(any(map(str.isalnum, word)) for word in self.text.split())


def markdown(text: str) -> Iterator[Line]:
    """Yields every line of a document."""
    yield from (Line(number, line) for number, line in enumerate(text.splitlines(), 1))


def rust(text: str) -> Iterator[Line]:
    """Yields the comments of a Rust file; a line of code ends a paragraph."""
    for number, line in enumerate(text.splitlines(), 1):
        comment = RUST_COMMENT.search(line)
        yield Line(number, (comment.group(1) or "") if comment else "")


def python(text: str) -> Iterator[Line]:
    """Yields the comments and docstrings of a Python file."""
    before = tokenize.NEWLINE
    layout = {tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENCODING}
    last = 0
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        row = token.start[0]
        if token.type == tokenize.COMMENT:
            if row > last + 1:
                yield Line(row, "")
            yield Line(row, token.string.lstrip("# "))
            last = row
        elif token.type == tokenize.STRING and before in layout:
            yield Line(row, "")
            doc = token.string.strip("rR\"'")
            yield from (Line(row + n, line) for n, line in enumerate(doc.splitlines()))
            yield Line(token.end[0], "")
        if token.type not in {tokenize.COMMENT, tokenize.NL}:
            before = token.type


def paragraphs(lines: Iterable[Line]) -> Iterator[list[Line]]:
    """Splits at blank lines, list items and headings, and leaves code and tables out."""
    found: list[Line] = []
    code = False
    for number, text in lines:
        if fence := FENCE.match(text):
            code = not code
        starts = bool(ITEM.match(text) or HEADING.match(text))
        prose = not (code or fence or NO_PROSE.match(text) or text.lstrip().startswith(">>>"))
        if found and (starts or not prose or not text.strip() or HEADING.match(found[-1].text)):
            yield found
            found = []
        if prose and text.strip():
            found.append(Line(number, ITEM.sub("", text)))
    if found:
        yield found


def sentences(path: str, lines: Iterable[Line]) -> Iterator[Sentence]:
    """Splits prose into sentences."""
    for paragraph in paragraphs(lines):
        text = "\n".join(line.text.strip(" \t>#") for line in paragraph)
        text = LINK.sub(r"\1", CODE.sub(lambda code: "`code`" + "\n" * code[0].count("\n"), text))
        text = ADDRESS.sub("address", text)
        at = 0
        for end in [match.end() for match in FULL_STOP.finditer(text)] + [len(text)]:
            line = paragraph[min(text.count("\n", 0, at), len(paragraph) - 1)].number
            yield Sentence(path, line, " ".join(text[at:end].split()))
            at = end


READERS = {".md": markdown, ".rs": rust, ".py": python, ".pyi": python}
GROUPS = {".md": "documents", ".rs": "Rust comments", ".py": "Python comments"}


def tracked(root: Path) -> list[str]:
    """Returns the repository's files of which this script reads the prose."""
    patterns = [f"*{suffix}" for suffix in READERS]
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "--", *patterns]
    out = subprocess.run(command, cwd=root, check=True, capture_output=True, text=True).stdout
    return [path for path in sorted(out.splitlines()) if (root / path).is_file()]


def report(name: str, value: float, bar: float, unit: str, offences: Iterable[Sentence]) -> bool:
    """Prints a measure, and its offences where it is above its bar; returns whether it is not."""
    good = value <= bar
    print(f"{name}: {value:.2f} {unit} (bar {bar:g}){'' if good else ': ABOVE'}")
    if not good or "--list" in sys.argv[1:]:
        for offence in offences:
            print(f"  {offence.path}:{offence.line}: [{offence.words}] {offence.text}")
    return good


def main() -> int:
    """Prints the measures and returns the exit code, 1 where one is above its bar."""
    root = Path(__file__).resolve().parent.parent
    found: dict[str, list[Sentence]] = {group: [] for group in GROUPS.values()}
    for path in tracked(root):
        suffix = Path(path).suffix
        lines = READERS[suffix]((root / path).read_text(encoding="utf-8"))
        found[GROUPS[suffix.removesuffix("i")]] += sentences(path, lines)
    documents = found["documents"]
    long = [sentence for sentence in documents if sentence.words > LONG]
    name = f"documents, sentences over {LONG} words ({len(long)} of {len(documents)})"
    good = [report(name, 100 * len(long) / len(documents), 100 * LONG_SHARE, "%", long)]
    for group, members in found.items():
        words = sum(sentence.words for sentence in members)
        for label, pattern, bar in [("who", WHO, WHO_RATE), ("somebody", SOMEBODY, SOMEBODY_RATE)]:
            hits = [sentence for sentence in members if pattern.search(sentence.text)]
            count = sum(len(pattern.findall(sentence.text)) for sentence in members)
            name = f"{group}, `{label}` and its like ({count} in {words:,} words)"
            good.append(report(name, 1000 * count / words, bar, "per 1,000 words", hits))
    return 0 if all(good) else 1


if __name__ == "__main__":
    sys.exit(main())
