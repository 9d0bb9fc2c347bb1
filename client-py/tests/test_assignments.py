"""Options as text: one syntax in Rust and Python."""

from __future__ import annotations

import json
import subprocess
from typing import Any

import pytest

import trocar
from trocar._assignments import assignments
from trocar.errors import InvalidOption

CASES: list[tuple[list[str], dict[str, Any]]] = [
    (["reward=dense", "rate=10"], {"reward": "dense", "rate": 10}),
    (["observation=state,joints"], {"observation": ["state", "joints"]}),
    (['observation=["state", "joints"]'], {"observation": ["state", "joints"]}),
    (["observation=state"], {"observation": ["state"]}),
    (
        ["domain.latency_seconds=0,0.06", "domain.preset=dvrk"],
        {"domain": {"latency_seconds": [0, 0.06], "preset": "dvrk"}},
    ),
    (
        ['domain={"preset": "dvrk"}', "domain.latency=[0, 2]"],
        {"domain": {"preset": "dvrk", "latency": [0, 2]}},
    ),
    (["camera_eye=0.8,0.2,0.9"], {"camera_eye": [0.8, 0.2, 0.9]}),
]


@pytest.mark.parametrize(("given", "expected"), CASES)
def test_assignments_are_values_by_name(given: list[str], expected: dict[str, Any]) -> None:
    assert assignments(given) == expected


@pytest.mark.parametrize(("given", "expected"), CASES)
def test_the_program_reads_the_same_values(
    given: list[str], expected: dict[str, Any], server: str
) -> None:
    """The same episode follows from flags of the program and from options of an environment."""
    flags = [flag for assignment in given for flag in ("--option", assignment)]
    command = [trocar.binary(), "rollout", "--task", "NeedleReach", "--episodes", "1", "--json"]
    done = subprocess.run([*command, *flags], capture_output=True, text=True, check=True)
    env = trocar.TrocarVectorEnv("NeedleReach-v0", 1, server=server, expert=True, **expected)
    _, infos = env.reset(seed=0)
    total = 0.0
    for _ in range(env.task_spec.max_steps):
        _, rewards, *_, infos = env.step(infos["expert_action"])
        total += float(rewards[0])
    env.close()
    assert json.loads(done.stdout)["mean_return"] == pytest.approx(total, rel=1e-6)


@pytest.mark.parametrize("given", ["reward", "=dense", "domain.=1,2", "domain={", 'reward="dense'])
def test_other_texts_are_refused(given: str) -> None:
    with pytest.raises(InvalidOption):
        assignments([given])
