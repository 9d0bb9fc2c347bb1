"""Third-party notices of the wheels: complete, and missed if they are not there."""

import importlib.util
import shutil
import sys
import zipfile
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]

pytestmark = pytest.mark.skipif(shutil.which("cargo") is None, reason="needs cargo metadata")


@pytest.fixture(scope="module")
def notices() -> Any:
    spec = importlib.util.spec_from_file_location("notices", ROOT / "tests" / "notices.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    sys.modules["notices"] = module
    spec.loader.exec_module(module)
    return module


def test_every_work_has_a_notice_with_its_text(notices: Any, tmp_path: Path) -> None:
    found = notices.metadata()
    for wheel in notices.WHEELS:
        works = notices.works(found, wheel)
        text = notices.notices(wheel, works)
        assert text == notices.notices(wheel, notices.works(found, wheel))
        assert notices.missing(works, text) == []
        assert any(work.title.startswith("iceoryx2 ") for work in works)
        assert all(sum(map(len, work.texts)) > 100 for work in works)
        titles = [work.title.split()[0] for work in works]
        assert ("three.js" in titles, "rapier3d" in titles) == (wheel.crate == "trocar",) * 2

        path = tmp_path / f"{wheel.name}-0.1.0-py3-none-any.whl"
        for content, faults in ((None, 2), ("", len(works)), (text, 0)):
            with zipfile.ZipFile(path, "w") as file:
                if content is not None:
                    folder = f"{wheel.name}-0.1.0.dist-info/licenses"
                    file.writestr(f"{folder}/LICENSE", "words")
                    file.writestr(f"{folder}/{notices.NAME}", content)
            assert len(notices.check(found, path)) == faults


def test_a_notice_without_its_text_is_missed(notices: Any) -> None:
    works = [notices.Work("one 1.0", "MIT", "", "https://one", ("the words of its licence",))]
    text = notices.notices(notices.WHEELS[0], works)
    assert notices.missing(works, text) == []
    assert notices.missing(works, text.replace("the words", "")) == ["one 1.0"]
