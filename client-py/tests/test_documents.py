"""The check of documents finds planted faults: wrong names, and figures without an owner."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]


def load(path: Path) -> Any:
    specification = importlib.util.spec_from_file_location(path.stem, path)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


documents = load(ROOT / "tests" / "documents.py")
names = documents.Names(ROOT)

SOUND = """\
`trocar rollout --episodes 3 --option grasp=weld` and `make test-rust` exist, and so do `TaskSpec`
and `trocar_threads_busy_seconds_total`.

```sh
make demo
trocar serve --client-sessions 4
```
"""


def test_names_that_exist_are_no_offences() -> None:
    assert list(documents.offences(SOUND, names)) == []


@pytest.mark.parametrize(
    ("sound", "planted", "offence"),
    [
        ("--episodes", "--episodez", "1: no flag --episodez"),
        ("grasp=weld", "gripp=weld", "1: no option gripp"),
        ("make test-rust", "make test-rusty", "1: no target test-rusty of make"),
        ("TaskSpec", "TaskSpecimen", "1: no type TaskSpecimen"),
        ("trocar_threads_busy", "trocar_threads_lazy", "2: no metric"),
        ("make demo", "make demonstration", "5: no target demonstration of make"),
        ("--client-sessions", "--client-sessionz", "6: no flag --client-sessionz"),
    ],
)
def test_planted_names_are_found(sound: str, planted: str, offence: str) -> None:
    (found,) = documents.offences(SOUND.replace(sound, planted), names)
    assert found.startswith(offence)


def test_a_figure_of_the_readme_needs_a_page_that_has_it() -> None:
    pages = "| `NeedlePick-v0` | 53,300 | 1,580 |"
    assert list(documents.unowned_figures("It makes 53,300 steps.", pages)) == []
    (found,) = documents.unowned_figures("It makes 35,400 steps.", pages)
    assert "35,400" in found


def test_the_documents_have_no_offences() -> None:
    assert documents.main() == 0
