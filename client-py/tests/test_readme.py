"""The Python quick start of README.md, run as a reader would paste it."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

README = Path(__file__).parents[2] / "README.md"
BLOCKS = re.findall(r"^```python\n(.*?)^```$", README.read_text(), re.MULTILINE | re.DOTALL)


def test_the_readme_has_a_quick_start() -> None:
    assert len(BLOCKS) >= 2


@pytest.mark.parametrize("block", BLOCKS)
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
