"""Hands on, in a real browser: the page drives the arms of a live world by keys."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from chromium import PATIENCE, Chromium

from trocar.demos._by_hand import demonstrate
from trocar.dvrk import LiveEnv

BINARY = os.environ.get("TROCAR_BINARY", "trocar")

#: What the page says of its own accord.
NOTICE = "document.querySelector('#notice').innerText"


@contextlib.contextmanager
def world(task: str, out: Path) -> Iterator[str]:
    """A live world that waits to be driven, at an address; what was done is recorded."""
    command = [BINARY, "drive", "--task", task, "--speed", "2", "--out", str(out)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        try:
            assert process.stdout is not None
            yield process.stdout.readline().strip()
        finally:
            process.send_signal(signal.SIGINT)
            assert process.wait(PATIENCE) == 0


def look(browser: Chromium, address: str) -> None:
    """Opens the page, which shows the world and offers to drive."""
    browser.open(address)
    browser.wait_for("Number(document.body?.dataset.frames) > 1")
    browser.wait_for("!document.querySelector('#drive').hidden")


def test_keys_move_the_arm_and_what_was_done_plays_again(tmp_path: Path) -> None:
    """Bit by bit; a second page, and one without the token, are refused."""
    recording = tmp_path / "hands.trocar"
    with world("NeedlePick-v0", recording) as address, Chromium() as browser, Chromium() as other:
        look(browser, address)
        browser.press("g")
        browser.wait_for("document.body.dataset.drives === 'PSM1'")
        before = browser.picture()
        for key in ("w", "f", "q"):
            with browser.holding(key):
                time.sleep(0.6)
        browser.press(" ")
        time.sleep(1.0)
        assert browser.picture() != before
        assert browser.run(NOTICE) == ""

        # The second page learns that another page drives.
        look(other, address)
        other.press("g")
        other.wait_for(f"{NOTICE}.includes('a page of the viewer drives it')")
        assert other.run("document.body.dataset.drives") == ""
        # A page that does not know the token is offered nothing, and may not do it either.
        other.open("about:blank")
        other.open(address.split("#", maxsplit=1)[0])
        other.wait_for("Number(document.body?.dataset.frames) > 1")
        assert other.run("document.querySelector('#drive').hidden")
        wish = {"session": 1, "token": "0" * 32, "arm": "PSM1", "motion": "hold"}
        other.run(
            "globalThis.said = []; globalThis.own = new WebSocket(new URL('live', location.href"
            ".replace('http', 'ws'))); own.onmessage = ({ data }) => said.push(data);"
            f" own.onopen = () => own.send(JSON.stringify({{ drive: {json.dumps(wish)} }}))"
        )
        other.wait_for("said.some((each) => String(each).includes('this page may not drive'))")
        # Once the first page lets go, the second one may.
        browser.press("g")
        browser.wait_for("document.body.dataset.drives === ''")
        other.open("about:blank")
        look(other, address)
        other.press("g")
        with other.holding("r"):
            time.sleep(0.4)
        assert other.run(NOTICE) == ""
        assert browser.errors == other.errors == []
    command = [BINARY, "replay", str(recording), "--json"]
    replayed = subprocess.run(command, capture_output=True, text=True, check=True)
    (row,) = [json.loads(line) for line in replayed.stdout.splitlines()]
    assert (row["task"], row["failed"]) == ("NeedlePick-v0", False)
    assert row["snapshots"] > 3


def test_a_person_corrects_a_policy_gives_the_arm_back_and_demonstrates() -> None:
    """Infos say when a person drove, and what was done instead of the policy's action."""
    env = LiveEnv("NeedleReach-v0", speed=2.0, intervention=True, max_steps=10_000)
    policy = np.array([0.0, 0.0, 0.1, 0.0, -1.0], np.float32)
    with contextlib.closing(env), Chromium() as browser:
        env.reset(seed=0)
        look(browser, env.page)
        *_, info = env.step(policy)
        assert not info["is_intervention"]
        assert np.array_equal(info["action"], policy)

        def step_until(is_intervention: bool) -> None:
            for _ in range(600):
                *_, info = env.step(policy)
                if info["is_intervention"] == is_intervention:
                    return
            raise AssertionError(f"is_intervention stays {not is_intervention}")

        browser.press("g")
        step_until(is_intervention=True)
        with browser.holding("w"):
            done = [env.step(policy)[-1] for _ in range(5)]
        assert all(info["is_intervention"] for info in done)
        # The page moves at 3 cm/s; a step takes a tenth of a second here, as life goes.
        assert max(np.abs(info["action"][:2]).max() for info in done) > 0.2
        browser.press("g")
        step_until(is_intervention=False)

        # An episode by hand: from taking the arm over to giving it back.
        with ThreadPoolExecutor() as person:
            episode = person.submit(demonstrate, env, 3)
            browser.press("g")
            with browser.holding("f"):
                time.sleep(1.0)
            browser.press("g")
            shown = episode.result(PATIENCE)
        assert browser.errors == []
    assert shown.seed == 3
    assert len(shown) >= 3
    assert shown.observation.shape[0] == len(shown) + 1
    assert shown.action[:, 2].min() < -0.2
    assert shown.truncated.tolist() == [False] * (len(shown) - 1) + [True]
