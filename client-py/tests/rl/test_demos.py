"""Demonstrations: what is recorded, kept, resumed and refused."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path
from typing import Any

import gymnasium as gym
import minari
import numpy as np
import pyarrow.parquet as pq
import pytest

import trocar
from trocar.demos import Recording, dataset_path, record
from trocar.demos.__main__ import main

TASK = "NeedlePick-v0"
NOISY: dict[str, Any] = {"domain": {"action_noise": [0.003, 0.003]}}


def loaded(
    out: Path, task: str, name: str, monkeypatch: pytest.MonkeyPatch
) -> minari.MinariDataset:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(out))
    return minari.load_dataset(f"trocar/{task}/{name}")


# `make develop` puts the sources on the path, where Minari looks for an installed package.
@pytest.mark.filterwarnings("ignore:Package trocar is not installed:UserWarning")
def test_a_minari_data_set_is_what_the_environment_gives(
    tmp_path: Path, server: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = record(TASK, episodes=5, out=tmp_path, seed=40, envs=3, server=server, spawn="narrow")
    assert told == Recording(TASK, 5, 5, str(dataset_path(tmp_path, TASK)))
    dataset = loaded(tmp_path, TASK, "expert-v0", monkeypatch)
    assert dataset.total_episodes == 5
    recipe = json.loads(dataset.storage.metadata["trocar"])
    assert recipe == {
        "task": TASK,
        "options": {"spawn": "narrow"},
        "seed": 40,
        "episodes": 5,
        "keeps_failures": False,
        "by_hand": False,
        "version": trocar.__version__,
        "stages": list(trocar.STAGES),
    }
    env = dataset.recover_environment(server=server).unwrapped
    seeds = [meta["seed"] for meta in dataset.storage.get_episode_metadata(range(5))]
    assert seeds == [40, 41, 42, 43, 44]
    for seed, episode in zip(seeds, dataset.iterate_episodes(), strict=True):
        seen, _ = env.reset(seed=seed)
        for step, action in enumerate(episode.actions):
            assert all((seen[key] == episode.observations[key][step]).all() for key in seen)
            seen, reward, terminated, truncated, info = env.step(action)
            assert reward == episode.rewards[step]
            assert (terminated, truncated) == (
                episode.terminations[step],
                episode.truncations[step],
            )
            assert info["is_success"] == episode.infos["is_success"][step + 1]
        assert info["is_success"]
        names = [trocar.STAGES[number] for number in episode.infos["expert_stage"]]
        in_order = [
            name for name, before in zip(names, [None, *names], strict=False) if name != before
        ]
        assert in_order == ["approach", "pick", "lift", "carry"]
    env.close()


def test_a_folder_may_be_told_from_where_one_is(
    tmp_path: Path, server: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    told = record(TASK, episodes=1, out="runs", server=server)
    assert Path(told.path).is_dir()
    assert loaded(tmp_path / "runs", TASK, "expert-v0", monkeypatch).total_episodes == 1


def test_failures_are_dropped_unless_they_are_wanted(
    tmp_path: Path, server: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    some = record(TASK, episodes=6, out=tmp_path, server=server, **NOISY)
    everything = record(
        TASK, episodes=6, out=tmp_path, name="all-v0", keep_failures=True, server=server, **NOISY
    )
    assert everything.kept == 6
    assert 0 < some.kept < 6
    dataset = loaded(tmp_path, TASK, "all-v0", monkeypatch)
    succeeded = [bool(episode.infos["is_success"][-1]) for episode in dataset.iterate_episodes()]
    assert sum(succeeded) == some.kept


@pytest.mark.parametrize("form", ["minari", "lerobot"])
def test_episodes_of_large_seeds_are_recorded(form: str, tmp_path: Path, server: str) -> None:
    told = record(
        "NeedleReach-v0", episodes=2, out=tmp_path, seed=2**63 - 1, format=form, server=server
    )
    assert told.kept == 2


def test_tasks_without_goals_are_recorded_too(
    tmp_path: Path, server: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    record("ActiveTrack-v0", episodes=2, out=tmp_path, server=server)
    dataset = loaded(tmp_path, "ActiveTrack-v0", "expert-v0", monkeypatch)
    assert dataset[0].observations.shape == (501, 10)


@pytest.mark.filterwarnings("ignore:.*is set to None:UserWarning")
@pytest.mark.filterwarnings("ignore:.*TemporaryDirectory:ResourceWarning")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("expert", [False, True])
def test_minaris_collector_records_infos(
    expert: bool, tmp_path: Path, server: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It wants infos of one shape, and draws seeds of 64 bits for resets that have none."""
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    env = minari.DataCollector(
        gym.make("trocar/NeedleReach-v0", server=server, expert=expert), record_infos=True
    )
    env.action_space.seed(0)
    for _ in range(8):
        env.reset()
        while not env.step(env.action_space.sample())[3]:
            pass
    dataset = env.create_dataset(f"trocar/collected-{expert}-v0")
    env.close()
    seeds = {int(episode.infos["episode_seed"][0]) for episode in dataset.iterate_episodes()}
    assert len(seeds) == 8
    for episode in dataset.iterate_episodes():
        assert all(len(values) == 51 for values in episode.infos.values())


class Stop(Exception):
    pass


def stop_after(episodes: int) -> Any:
    def progress(done: int, kept: int) -> None:
        del kept
        if done >= episodes:
            raise Stop

    return progress


def test_an_interrupted_recording_goes_on_and_gives_the_same(
    tmp_path: Path, server: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings: dict[str, Any] = {"episodes": 7, "out": tmp_path, "server": server}
    record("NeedleReach-v0", name="straight-v0", envs=7, **settings)
    with pytest.raises(Stop):
        record("NeedleReach-v0", name="broken-v0", envs=2, progress=stop_after(4), **settings)
    with pytest.raises(ValueError, match="resume"):
        record("NeedleReach-v0", name="broken-v0", **settings)
    for change, value in (("seed", 1), ("episodes", 8), ("reward", "dense")):
        with pytest.raises(ValueError, match="options" if change == "reward" else change):
            record(
                "NeedleReach-v0",
                **(settings | {"name": "broken-v0", "resume": True, change: value}),
            )
    seen: list[int] = []
    record(
        "NeedleReach-v0",
        name="broken-v0",
        envs=3,
        resume=True,
        progress=lambda *counts: seen.append(counts[0]),
        **settings,
    )
    assert seen == [4, 7]
    straight = loaded(tmp_path, "NeedleReach-v0", "straight-v0", monkeypatch)
    broken = loaded(tmp_path, "NeedleReach-v0", "broken-v0", monkeypatch)
    for one, other in zip(straight.iterate_episodes(), broken.iterate_episodes(), strict=True):
        assert (one.actions == other.actions).all()
        for key, rows in one.observations.items():
            assert (rows == other.observations[key]).all()
    again = record("NeedleReach-v0", name="broken-v0", resume=True, **settings)
    assert again.kept == 7
    with pytest.raises(ValueError, match="there is a data set already"):
        record("NeedleReach-v0", name="broken-v0", **settings)
    assert not list(tmp_path.rglob("*.partial*"))


def test_lerobot_s_files_fit_together(tmp_path: Path, server: str) -> None:
    # lerobot 0.4.4 itself reads it; it is too large for this environment.
    record(TASK, episodes=3, out=tmp_path, format="lerobot", server=server)
    folder = dataset_path(tmp_path, TASK)
    info = json.loads((folder / "meta/info.json").read_text())
    assert (info["codebase_version"], info["fps"]) == ("v3.0", 5)
    assert (info["total_episodes"], info["total_frames"]) == (3, 150)
    frames = pq.read_table(folder / info["data_path"].format(chunk_index=0, file_index=0))
    assert set(frames.column_names) == set(info["features"])
    columns = {name: np.stack(frames[name].to_numpy()) for name in frames.column_names}
    assert (columns["index"] == np.arange(150)).all()
    assert columns["observation.state"].shape == (150, 19)
    stats = json.loads((folder / "meta/stats.json").read_text())
    assert np.allclose(stats["action"]["mean"], columns["action"].mean(axis=0))
    episodes = pq.read_table(folder / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    for number, row in enumerate(episodes):
        assert (row["dataset_from_index"], row["dataset_to_index"]) == (
            50 * number,
            50 * number + 50,
        )
        assert (columns["episode_index"][50 * number : 50 * number + 50] == number).all()
    subtasks = pq.read_table(folder / "meta/subtasks.parquet").to_pydict()["subtask"]
    assert [subtasks[number] for number in columns["subtask_index"][[0, -1]]] == [
        "approach",
        "carry",
    ]
    assert columns["next.done"].sum() == 3


def test_bad_input_is_refused_and_leaves_nothing(
    tmp_path: Path, server: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for bad in (
        {"task": "NoSuchTask-v0"},
        {"task": TASK, "spawn": "nowhere"},
        {"task": TASK, "colour": "red"},
        {"task": TASK, "format": "csv"},
        {"task": TASK, "episodes": 0},
    ):
        with pytest.raises(ValueError, match=r"allowed|knows"):
            record(out=tmp_path, server=server, **bad)
    flags = ["--out", str(tmp_path), "--server", server]
    assert main(["--task", "NoSuchTask-v0", *flags]) == 2
    assert "NeedlePick-v0" in capsys.readouterr().err
    assert main(["--task", TASK, "--out", str(tmp_path), "--server", "no-such-server"]) == 3
    assert list(tmp_path.iterdir()) == []


@pytest.mark.filterwarnings("ignore:Package trocar is not installed:UserWarning")
@pytest.mark.parametrize(
    ("task", "options"),
    [
        (TASK, {"observation": ["state", "rgb"], "image_size": [40, 32]}),
        (TASK, {"observation": ["state", "depth", "mask"], "image_size": [16, 16]}),
        (TASK, {"observation": ["rgb", "points"], "image_size": [8, 8], "camera": "stereo"}),
        ("ActiveTrack-v0", {"observation": ["rgb"], "image_size": [16, 16]}),
    ],
)
def test_a_minari_data_set_has_the_pictures_of_the_environment(
    task: str,
    options: dict[str, Any],
    tmp_path: Path,
    server: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    record(task, episodes=2, out=tmp_path, server=server, **options)
    dataset = loaded(tmp_path, task, "expert-v0", monkeypatch)
    told = json.loads(dataset.storage.metadata["trocar"])
    env = dataset.recover_environment(server=server).unwrapped
    assert dataset.observation_space == env.observation_space
    assert told["images"]["kinds"] == env.task_spec.images.kinds
    assert told["images"]["intrinsics"] == env.task_spec.images.intrinsics
    for seed, episode in enumerate(dataset.iterate_episodes()):
        seen, _ = env.reset(seed=seed)
        for step, action in enumerate(episode.actions[:20]):
            stored = {key: rows[step] for key, rows in episode.observations.items()}
            assert dataset.observation_space.contains(stored)
            assert [key for key in seen if (seen[key] != stored[key]).any()] == [], step
            seen, *_ = env.step(action)
        assert all(len(rows) == len(episode) + 1 for rows in episode.observations.values())
    env.close()


@pytest.mark.parametrize("kinds", [["state", "rgb"], ["state", "depth", "mask"], ["rgb"]])
def test_lerobot_refuses_pictures_before_the_first_episode(
    tmp_path: Path, server: str, kinds: list[str]
) -> None:
    with pytest.raises(ValueError, match=r"options\.observation = .*no pictures.*minari"):
        record(TASK, out=tmp_path, server=server, format="lerobot", observation=kinds)
    assert list(tmp_path.iterdir()) == []


def test_an_interrupted_recording_keeps_its_pictures(
    tmp_path: Path, server: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    options: dict[str, Any] = {"observation": ["rgb"], "image_size": [8, 8]}
    settings: dict[str, Any] = {"episodes": 3, "out": tmp_path, "server": server, **options}
    record("NeedleReach-v0", name="straight-v0", **settings)
    with pytest.raises(Stop):
        record("NeedleReach-v0", name="broken-v0", envs=2, progress=stop_after(2), **settings)
    record("NeedleReach-v0", name="broken-v0", resume=True, **settings)
    straight = loaded(tmp_path, "NeedleReach-v0", "straight-v0", monkeypatch)
    broken = loaded(tmp_path, "NeedleReach-v0", "broken-v0", monkeypatch)
    assert broken.total_episodes == 3
    for one, other in zip(straight.iterate_episodes(), broken.iterate_episodes(), strict=True):
        assert (one.observations["rgb"] == other.observations["rgb"]).all()


@pytest.mark.parametrize("form", ["minari", "lerobot"])
def test_a_full_disk_ends_in_an_error_and_harms_no_other_data_set(
    form: str, tmp_path: Path, server: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Allocation and writing fail as on a full disk."""

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    settings: dict[str, Any] = {"episodes": 2, "out": tmp_path, "server": server, "format": form}
    record("NeedleReach-v0", **(settings | {"format": "minari"}))
    with monkeypatch.context() as patch:
        patch.setattr(os, "posix_fallocate", full)
        patch.setattr(pq, "write_table", full)
        with pytest.raises(OSError, match="No space left"):
            record("NeedleReach-v0", name="full-v0", **settings)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert list(minari.list_local_datasets()) == ["trocar/NeedleReach-v0/expert-v0"]
    names = {path.name for path in dataset_path(tmp_path, "NeedleReach-v0").parent.iterdir()}
    assert names == {"expert-v0", ".full-v0.partial"}
    assert record("NeedleReach-v0", name="full-v0", resume=True, **settings).kept == 2


def test_a_folder_has_one_recorder_at_a_time(tmp_path: Path, server: str) -> None:
    settings: dict[str, Any] = {"episodes": 4, "envs": 2, "out": tmp_path, "server": server}
    refused = []

    def meanwhile(done: int, kept: int) -> None:
        del kept
        if done == 2:
            with pytest.raises(ValueError, match="another process records there"):
                record("NeedleReach-v0", resume=True, **settings)
            refused.append(done)

    assert record("NeedleReach-v0", progress=meanwhile, **settings).kept == 4
    assert refused == [2]


def test_the_command_records_with_python(tmp_path: Path, server: str) -> None:
    command = [trocar.binary(), "demos", "--task", "GauzeRetrieve-v0", "--episodes", "2"]
    command += ["--out", str(tmp_path), "--server", server, "--spawn", "narrow", "--json"]
    variables = os.environ | {"TROCAR_PYTHON": sys.executable}
    said = json.loads(subprocess.check_output(command, env=variables))
    path = dataset_path(tmp_path, "GauzeRetrieve-v0")
    assert said == {"task": "GauzeRetrieve-v0", "episodes": 2, "kept": 2, "path": str(path)}
    dataset = minari.MinariDataset(path / "data")
    assert dataset.total_episodes == 2
    assert json.loads(dataset.storage.metadata["trocar"])["options"] == {"spawn": "narrow"}


def test_a_missing_extra_is_named(
    tmp_path: Path, server: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(sys.modules, "trocar.demos._minari", raising=False)
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(ModuleNotFoundError, match=r"\[demos\]"):
        record(TASK, episodes=1, out=tmp_path, server=server)


@pytest.mark.filterwarnings("ignore:Package trocar is not installed:UserWarning")
@pytest.mark.parametrize("form", ["minari", "lerobot"])
def test_a_task_of_another_server_is_recorded(
    form: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = Path(trocar.binary()).resolve().parent / "examples" / "own_task"
    if not program.exists():
        pytest.skip("cargo build -p trocar-server --example own_task makes it")
    name = f"own-demos-{os.getpid()}"
    process = subprocess.Popen([program, name], stderr=subprocess.DEVNULL)
    try:
        deadline = time.monotonic() + 60.0
        while not runs(name):
            assert time.monotonic() < deadline
            time.sleep(0.01)
        flags = ["--task", "PushCube-v0", "--episodes", "2", "--server", name, "--format", form]
        assert main([*flags, "--out", str(tmp_path)]) == 0
        if form == "minari":
            dataset = loaded(tmp_path, "PushCube-v0", "expert-v0", monkeypatch)
            env = dataset.recover_environment()
            assert env.observation_space == dataset.observation_space
            env.close()
    finally:
        process.send_signal(signal.SIGINT)
        assert process.wait() == 0


def runs(server: str) -> bool:
    try:
        trocar.status(server)
    except trocar.errors.NoServer:
        return False
    return True
