"""Programs of the documents that need Stable-Baselines3 run as pasted, with fewer steps."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[3] / "docs"
STEPS = 1_100
"""Environment steps of each training: past the first 1,000 steps, in which SAC acts at random."""


def blocks() -> list[object]:
    """Every block marked ``python sb3``, with the name of its page."""
    return [
        pytest.param(block, id=f"{page.name}-{index}")
        for page in sorted(DOCS.glob("*.md"))
        for index, block in enumerate(
            re.findall(r"^```python sb3\n(.*?)^```$", page.read_text(), re.MULTILINE | re.DOTALL)
        )
    ]


def test_the_documents_have_programs_with_stable_baselines3() -> None:
    assert len(blocks()) >= 3


@pytest.mark.parametrize("block", blocks())
def test_blocks_run_as_pasted(block: str, tmp_path: Path) -> None:
    path = tmp_path / "pasted.py"
    path.write_text(re.sub(r"learn\([\d_]+", f"learn({STEPS}", block))
    done = subprocess.run(
        [sys.executable, str(path)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
