"""Training runs: a few hundred updates of each algorithm, the same again, interrupted, refused."""

from __future__ import annotations

import base64
import json
import shlex
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import cloudpickle  # type: ignore[import-untyped]
import numpy as np
import onnx
import pytest
import torch
from onnx.reference import ReferenceEvaluator

import trocar
from trocar.demos import record
from trocar.errors import InvalidRequest
from trocar.registration import SERVED
from trocar.rl import Config, Run, export, load, score, train
from trocar.rl.__main__ import main
from trocar.rl.curves import curves, find, plot, write_table
from trocar.rl.evaluation import wilson
from trocar.rl.export import card_of
from trocar.sb3 import make_vec

SMALL: dict[str, Any] = {
    "hidden": [16, 16],
    "epochs": 3,
    "epoch_episodes": 4,
    "eval_episodes": 4,
    "batch_size": 64,
}
OWN: dict[str, Any] = {
    "envs": 2,
    "updates": 1,
    "warm_up": 4,
    "critic_updates": 50,
    "enough": 0.0,
}
RUNS: dict[str, tuple[str, dict[str, Any]]] = {
    "her": ("NeedleReach-v0", {"updates": 60}),
    "her-demo": ("NeedlePick-v0", {"updates": 60, "demos": 3, "demo_batch": 16}),
    "ddpg": ("ActiveTrack-v0", {"updates": 60, "learning_starts": 400, "train_every": 250}),
    "ppo": ("NeedleReach-v0", {"envs": 4, "train_every": 50, "passes": 5, "batch_size": 50}),
    "td3-demo": ("NeedlePick-v0", {**OWN, "demos": 3, "demo_batch": 16, "clone_updates": 50}),
    "td3-her": ("NeedleReach-v0", {**OWN, "learning_starts": 200}),
    "dagger": ("NeedlePick-v0", {"envs": 2, "demos": 3, "clone_updates": 60}),
}
CLONED = ("clone_loss", "passed")
LOSSES: dict[str, set[str]] = {
    **{algo: {"actor_loss", "critic_loss"} for algo in ("her", "ddpg", "ppo", "td3-her")},
    **{algo: {"actor_loss", "critic_loss", *CLONED} for algo in ("her-demo", "td3-demo")},
    "dagger": {"clone_loss"},
}
"""What is told of each."""
TIMES = ("wall_s", "trainer_cpu_s", "server_cpu_s")


def small(algo: str, **changes: Any) -> Config:
    task, own = RUNS[algo]
    settings = SMALL | own | changes
    if algo == "ddpg":
        settings |= {"epochs": 2, "epoch_episodes": 2}
    return load(task, algo).but(**settings)


def quietly(line: str) -> None:
    del line


def curve(run: Run) -> list[dict[str, float]]:
    """Its rows without the times that they took."""
    return [{name: row[name] for name in row if name not in TIMES} for row in run.rows()]


class Stop(Exception):
    pass


@pytest.mark.parametrize("algo", RUNS)
def test_it_learns_the_same_again_and_after_an_interruption(
    algo: str, tmp_path: Path, server: str
) -> None:
    config = small(algo)
    straight = train(config, 1, out=tmp_path / "one", server=server, say=quietly)
    rows = curve(straight)
    assert [row["epoch"] for row in rows] == list(range(config.epochs + 1))
    assert rows[-1]["steps"] == rows[0]["steps"] + config.epochs * config.epoch_steps
    assert rows[-1]["updates"] >= 15 if algo == "ppo" else rows[-1]["updates"] >= 200
    assert all(np.isfinite(list(row.values())).all() for row in rows)
    told = {name for name in rows[-1] if name.endswith("loss") or name == "passed"}
    assert told == LOSSES[algo]
    for name in ("config.json", "curve.csv", "curve.png", "last.zip", "best.zip"):
        assert (straight.path / name).stat().st_size > 0
    assert list((straight.path / "tensorboard").iterdir())

    def stop(line: str) -> None:
        if "epoch   1" in line:
            raise Stop

    with pytest.raises(Stop):
        train(config, 1, out=tmp_path / "two", server=server, say=stop)
    with pytest.raises(ValueError, match="resume"):
        train(config, 1, out=tmp_path / "two", server=server, say=quietly)
    other = config.but(norm_clip=4.0)
    again: dict[str, Any] = {"resume": True, "trust": True}
    with pytest.raises(ValueError, match="norm_clip"):
        train(other, 1, out=tmp_path / "two", server=server, say=quietly, **again)
    resumed = train(
        config, 1, out=tmp_path / "two", server=server, resume=True, trust=True, say=quietly
    )
    assert curve(resumed) == rows
    if algo == "her":
        elsewhere = train(config, 2, out=tmp_path / "two", server=server, say=quietly)
        assert curve(elsewhere) != rows


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory, server: str) -> Run:
    """A run that knows little."""
    out = tmp_path_factory.mktemp("runs")
    return train(small("her", epochs=1), 0, out=out, server=server, say=quietly)


def test_an_exported_policy_acts_as_the_model_does(
    trained: Run, tmp_path: Path, server: str
) -> None:
    model = trained.policy("last")
    path = export(model, trained.config, tmp_path / "policy.onnx")
    told = onnx.load(path)
    metadata = {entry.key: entry.value for entry in told.metadata_props}
    assert metadata["trocar.task"] == "NeedleReach-v0"
    network = ReferenceEvaluator(told)
    assert [port.name for port in told.graph.input] == ["observation", "desired_goal"]
    envs = make_vec("trocar/NeedleReach-v0", 8, seed=0, server=server)
    seen: Any = envs.reset()
    expected, _ = model.predict(seen, deterministic=True)
    for row in range(8):
        inputs = {name: seen[name][row : row + 1] for name in ("observation", "desired_goal")}
        (action,) = network.run(None, inputs)
        assert action == pytest.approx(expected[row : row + 1], abs=1e-5)
    envs.close()

    # The command runs the same episodes, in its own process and in a server.
    envs = make_vec("trocar/NeedleReach-v0", 20, server=server)
    result = score(model, envs, 77)
    envs.close()
    for place in ([], ["--server", server]):
        command = [trocar.binary(), "rollout", "--policy", str(path), "--episodes", "20"]
        command += ["--seed", "77", "--json", *place]
        said = json.loads(subprocess.check_output(command))
        assert said["task"] == "NeedleReach-v0"
        assert said["policy"] == str(path)
        assert said["success_rate"] == result.success_rate
        assert said["mean_return"] == pytest.approx(result.mean_return, abs=0.11)
    wrong = [trocar.binary(), "rollout", "--policy", str(path), "--task", "EcmReach-v0"]
    refused = subprocess.run(wrong, capture_output=True, text=True, check=False)
    assert refused.returncode == 2
    assert "NeedleReach-v0" in refused.stderr


@pytest.mark.parametrize(
    ("algo", "changes"),
    [
        ("ppo", {"epochs": 1}),
        ("ddpg", {}),
        ("her", {"epochs": 1, "inputs": "relative"}),
        ("her-demo", {"epochs": 1, "inputs": ["relative", "desired_goal"]}),
        ("td3-her", {"epochs": 1}),
        ("dagger", {"epochs": 1}),
    ],
)
def test_every_algorithm_s_policy_can_be_exported(
    algo: str, changes: dict[str, Any], tmp_path: Path, server: str
) -> None:
    run = train(small(algo, **changes), 0, out=tmp_path, server=server, say=quietly)
    model = run.policy("last")
    path = export(model, run.config, tmp_path / "policy.onnx")
    network = ReferenceEvaluator(str(path))
    if "relative" in run.config.inputs:
        assert network.input_names == ["observation", "achieved_goal", "desired_goal"]
    envs = make_vec(run.config.task_id, 8, seed=3, server=server)
    seen: Any = envs.reset()
    expected, _ = model.predict(seen, deterministic=True)
    inputs = seen if isinstance(seen, dict) else {"observation": seen}
    for row in range(8):
        fed = {name: inputs[name][row : row + 1] for name in network.input_names}
        (action,) = network.run(None, fed)
        assert action == pytest.approx(expected[row : row + 1], abs=1e-5)
    assert np.abs(expected - expected[0]).max() > 1e-4
    result = score(model, envs, 77, 8)
    envs.close()
    if algo == "dagger":
        # The command runs it, features and all.
        command = [trocar.binary(), "rollout", "--policy", str(path), "--episodes", "8"]
        said = json.loads(subprocess.check_output([*command, "--seed", "77", "--json"]))
        assert said["success_rate"] == result.success_rate
        assert said["mean_return"] == pytest.approx(result.mean_return, abs=0.13)


def test_evaluation_says_how_sure_it_is(
    trained: Run, server: str, capsys: pytest.CaptureFixture[str]
) -> None:
    flags = ["--episodes", "12", "--envs", "5", "--server", server]
    assert main(["evaluate", "--trust", str(trained.path), *flags]) == 0
    said = json.loads(capsys.readouterr().out)
    assert (said["task"], said["episodes"], said["seed"]) == ("NeedleReach-v0", 12, 2_000_000)
    assert said["confidence_95"] == list(wilson(round(12 * said["success_rate"]), 12))
    # However many at a time: the same episodes.
    assert main(["evaluate", "--trust", str(trained.path), *flags[:2], "--server", server]) == 0
    assert json.loads(capsys.readouterr().out) == said


def test_cards_and_pages_say_what_was_measured(
    tmp_path: Path, server: str, capsys: pytest.CaptureFixture[str]
) -> None:
    config = small("her", epochs=1).but(noise=0.125, task_options={"spawn": "narrow"})
    run = train(config, 7, out=tmp_path / "runs", server=server, say=quietly)
    onnx_file = str(tmp_path / "policy.onnx")
    export_it = ["export", "--trust", str(run.path), "--card", "--out", onnx_file]
    assert main(export_it) == 2
    assert "evaluate" in capsys.readouterr().err
    flags = ["--episodes", "4", "--server", server, "--conditions"]
    assert main(["evaluate", "--trust", str(run.path), *flags]) == 0
    said = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    names = ["as trained", "twice the rate", "60 ms late", "noise 0.5 mm"]
    assert [told["condition"] for told in said] == names
    assert run.evaluations() == said
    assert all(told["options"]["spawn"] == "narrow" for told in said)
    assert main(export_it) == 0
    told = {entry.key: entry.value for entry in onnx.load(onnx_file).metadata_props}
    card = json.loads(told["trocar.card"])
    assert card["success_rate"] == said[0]["success_rate"]
    assert card["confidence_95"] == said[0]["confidence_95"]
    conditions = {each["name"]: each["success_rate"] for each in card["conditions"]}
    assert conditions == {each["condition"]: each["success_rate"] for each in said[1:]}
    words = shlex.split(card["command"])
    assert words[:4] == ["python", "-m", "trocar.rl", "train"]
    # Such a configuration comes out of the command again.
    again = main(["configs", *words[4:6], "--algo", "her", *words[words.index("7") + 1 :]])
    assert again == 0
    assert Config.from_json(capsys.readouterr().out.removeprefix(f"{onnx_file}\n")) == config

    (tmp_path / "policies").mkdir()
    best = ["best", "--trust", str(tmp_path / "runs")]
    assert main([*best, "--out", str(tmp_path / "policies")]) == 0
    assert card_of(tmp_path / "policies" / f"{config.task}.onnx") == card
    # A policy that was there before stays on the page.
    shutil.copy(onnx_file, tmp_path / "policies" / "StaticTrack-v0.onnx")
    assert main([*best, "--out", str(tmp_path / "policies")]) == 0
    rows = (tmp_path / "policies" / "README.md").read_text().splitlines()
    assert sum(row.startswith("| StaticTrack | her | ") for row in rows) == 1
    assert main(["export", "--trust", str(run.path), "--out", str(onnx_file)]) == 0
    with pytest.raises(InvalidRequest, match="expected a policy with a card"):
        card_of(Path(onnx_file))
    capsys.readouterr()

    ablation = tmp_path / "ablations" / "wide" / "seed-7"
    shutil.copytree(run.path, ablation)
    (ablation / "config.json").write_text(config.but(hidden=(512,)).to_json())
    assert (
        main(["evaluate", "--trust", str(run.path), "--episodes", "4", "--option", "rate=20"]) == 0
    )
    page = tmp_path / "page" / "RESULTS.md"
    assert main(["report", str(tmp_path), "--out", str(page), "--pictures", str(tmp_path)]) == 0
    text, ablations = page.read_text().split("## What settings are worth")
    assert "hidden=[512]" in ablations
    assert "hidden=[512]" not in text
    assert f"| {100 * said[0]['success_rate']:.1f} |" in text
    named, others = text.split("## Under other options")
    assert "| twice the rate |" in named
    assert "| rate=20 spawn=narrow |" in others
    assert "(../minutes.png)" in text
    assert all((tmp_path / name).stat().st_size > 0 for name in ("minutes.png", "learning.png"))


def test_wilson_s_interval_is_that_of_the_books() -> None:
    # Newcombe, Statistics in Medicine 17 (1998), table I: 81/263, 15/148, 0/20, 1/29.
    for successes, trials, low, high in (
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0000, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ):
        assert wilson(successes, trials) == pytest.approx((low, high), abs=1e-4)


def test_scores_are_of_the_episodes_that_were_asked_for(server: str) -> None:
    class Still:
        def predict(self, observation: Any, /, *, deterministic: bool) -> tuple[Any, None]:
            assert deterministic
            rows = len(observation["observation"] if isinstance(observation, dict) else observation)
            return np.zeros((rows, 3), np.float32), None

    envs = make_vec("trocar/ActiveTrack-v0", 4, server=server)
    result = score(Still(), envs, 5, 6)
    envs.close()
    single = trocar.TrocarEnv("ActiveTrack-v0", server=server)
    returns, lengths = [], []
    for seed in range(5, 11):
        single.reset(seed=seed)
        total, steps, over = 0.0, 0, False
        while not over:
            _, reward, terminated, truncated, _ = single.step(np.zeros(3))
            total, steps, over = total + reward, steps + 1, terminated or truncated
        returns.append(total)
        lengths.append(steps)
    single.close()
    assert result.episodes == 6
    assert result.mean_length == np.mean(lengths)
    assert result.mean_return == pytest.approx(np.mean(returns))
    assert min(lengths) < 500  # some lose the target


def test_curves_are_means_over_seeds(tmp_path: Path) -> None:
    for seed, values in enumerate(([0.0, 0.5], [0.2, 0.7], [0.4, 0.9, 1.0])):
        run = Run(tmp_path / f"seed-{seed}")
        run.begin(load("EcmReach", "her"), resume=False)
        run.write_rows([{"epoch": epoch, "success": value} for epoch, value in enumerate(values)])
    (made,) = curves(find(tmp_path))
    assert (made.task, made.label, made.runs) == ("EcmReach-v0", "her", 3)
    assert made.mean == pytest.approx([0.2, 0.7])
    assert made.std == pytest.approx([0.2, 0.2])
    assert made.error == pytest.approx(0.2 / np.sqrt(3))
    plot([made], tmp_path / "curves.png")
    write_table([made], tmp_path / "curves.csv")
    assert (tmp_path / "curves.png").stat().st_size > 0
    assert len((tmp_path / "curves.csv").read_text().splitlines()) == 3
    other = Run(tmp_path / "other")
    other.begin(load("EcmReach", "her-demo").but(curriculum=4), resume=False)
    other.write_rows([{"epoch": 0, "success": 0.0}])
    labels = [curve.label for curve in curves(find(tmp_path))]
    assert labels == ["her", "her-demo curriculum=4"]
    with pytest.raises(ValueError, match="expected a folder with runs"):
        find(tmp_path / "empty")


def test_tables_are_means_over_policies(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def line(run: str, grasp: str, tested: str, rate: float | None) -> str:
        told = {"task": "NeedlePick-v0", "algo": "her-demo", "run": run, "mean_return": -20.0}
        grasps = {"trained_with": {"grasp": grasp}, "options": {"grasp": tested}}
        return json.dumps(told | grasps | {"success_rate": rate}) + "\n"

    lines = [
        line("a/1", "weld", "weld", 0.0),
        line("a/1", "weld", "weld", 0.8),  # again: this one counts
        line("a/2", "weld", "weld", 0.9),
        line("a/1", "weld", "interact", 0.25),
        line("b/1", "approx", "interact", None),
    ]
    path = tmp_path / "evaluations.jsonl"
    path.write_text("".join(lines))
    assert main(["table", str(path)]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "| trained | grasp=weld | grasp=interact |",
        "| --- | --- | --- |",
        "| NeedlePick-v0 her-demo grasp=weld | 85.0 ± 7.1 (2) | 25.0 |",
        "| NeedlePick-v0 her-demo grasp=approx |  | -20.0 |",
    ]
    for broken, told in (("", "a line for each"), (lines[0] + "{}\n", ":2"), ("[1", ":1")):
        path.write_text(broken)
        assert main(["table", str(path)]) == 2
        assert told in capsys.readouterr().err


@pytest.mark.parametrize(
    ("task", "algo", "changes", "told"),
    [
        ("NoSuchTask", "her", {}, "NeedlePick-v0"),
        ("NeedlePick", "sac", {}, "her-demo"),
        ("ActiveTrack", "her", {}, "no goals"),
        ("NeedlePick", "her", {"nosuch": 1}, "batch_size"),
        ("NeedlePick", "her", {"gamma": "much"}, "gamma"),
        ("NeedlePick", "her", {"envs": 3}, "3 envs"),
        ("NeedlePick", "ppo", {"batch_size": 64}, "divides the 2000"),
        ("NeedlePick", "her", {"train_every": 25}, "multiples of 50"),
        ("NeedlePick", "her-demo", {"demo_batch": 5000}, "demo_batch"),
        ("NeedlePick", "her", {"inputs": ["smell"]}, "inputs"),
        ("ActiveTrack", "ddpg", {"action_l2": 1.0}, "ddpg does not use it"),
        ("NeedlePick", "her", {"clone_weight": 1.0}, "her-demo"),
        ("NeedlePick", "ppo", {"noise": 0.1}, "ppo does not use it"),
        ("NeedlePick", "bc", {"gamma": 0.9}, "bc does not use it"),
        ("NeedlePick", "td3-her", {"demos": 5}, "for a curriculum only"),
        ("NeedlePick", "td3-demo", {"demo_batch": 256}, "demo_batch"),
        ("NeedlePick", "td3-demo", {"envs": 24}, "multiple"),
        ("NeedlePick", "td3-demo", {"hindsight": 1.5}, "hindsight"),
        ("NeedlePick", "td3-demo", {"inputs": "smell"}, "relative"),
        ("NeedlePick", "td3-demo", {"enough": 2.0}, "enough"),
        ("NeedlePick", "td3-demo", {"critics": 1}, "critics"),
        ("NeedlePick", "td3-demo", {"n_steps": 0}, "n_steps"),
        ("NeedlePick", "her-demo", {"own_demos": True}, "her-demo does not use it"),
        ("NeedlePick", "dagger", {"epochs": 0}, "epochs"),
        ("NeedlePick", "dagger", {"clone_updates": 0}, "clone_updates"),
        ("ActiveTrack", "td3-demo", {}, "no goals"),
        ("ActiveTrack", "td3-her", {"hindsight": 0.5}, "no goals"),
    ],
)
def test_bad_configurations_are_refused(
    task: str, algo: str, changes: dict[str, Any], told: str
) -> None:
    with pytest.raises(ValueError, match=told):
        load(task, algo).but(**changes)


def test_every_task_has_its_configurations() -> None:
    for task in trocar.registration.TASKS:
        with_goals = () if task == "ActiveTrack-v0" else ("her", "her-demo", "td3-demo")
        for algo in ("ddpg", "ppo", "bc", "dagger", "td3-her", None, *with_goals):
            assert Config.from_json(load(task, algo).to_json()) == load(task, algo)
    assert load("NeedlePick", "her-demo").policy_weight == 0.001
    assert load("NeedlePick").algo == "dagger"
    assert load("NeedleReach").algo == "td3-her"
    assert load("NeedlePick", "her").but(inputs="relative").inputs == ("relative",)
    assert load("trocar/MisOrient-v0", "her").norm_eps == 0.01


def test_demonstrations_of_something_else_are_refused(tmp_path: Path, server: str) -> None:
    config = small("her-demo")

    def refused(path: Path, told: str) -> None:
        with pytest.raises(ValueError, match=told):
            train(config, 0, out=tmp_path / told, demos=path, server=server, say=quietly)

    other = record("GauzeRetrieve-v0", episodes=1, out=tmp_path, server=server)
    refused(Path(other.path), "task")
    option = record("NeedlePick-v0", episodes=1, out=tmp_path, server=server, spawn="narrow")
    refused(Path(option.path), "options")
    old = record("NeedlePick-v0", episodes=1, out=tmp_path, name="old-v0", server=server)
    metadata = Path(old.path) / "data" / "metadata.json"
    metadata.write_text(metadata.read_text().replace(trocar.__version__, "0.0.9"))
    refused(Path(old.path), "version")
    refused(tmp_path / "nothing", "expected the folder")


def test_the_command_line_says_what_is_wrong(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flags = ["--task", "NeedlePick", "--algo", "her"]
    assert main(["train", "--task", "NoSuchTask", "--algo", "her"]) == 2
    assert "NeedlePick-v0" in capsys.readouterr().err
    assert main(["train", *flags, "--set", "noise"]) == 2
    assert main(["train", *flags, "--server", "no-such-server", "--out", str(tmp_path)]) == 3
    assert main(["evaluate", "--trust", str(tmp_path)]) == 2
    assert "folder of a run" in capsys.readouterr().err
    assert main(["configs", *flags, "--set", "noise=0.5", "--option", "grasp=weld"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["noise"], told["task_options"]) == (0.5, {"grasp": "weld"})
    rows = ["--option", "domain.latency_seconds=0,0.06", "--option", "domain.preset=dvrk"]
    assert main(["configs", *flags, *rows, "--set", "inputs=observation,desired_goal"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["task_options"] == {"domain": {"latency_seconds": [0, 0.06], "preset": "dvrk"}}
    assert told["inputs"] == ["observation", "desired_goal"]
    for command in (["train", *flags], ["curves", str(tmp_path)], ["export", str(tmp_path)]):
        with pytest.raises(SystemExit, match="2"):
            main([*command, "--out", "/proc/out"])
        assert "/proc/out" in capsys.readouterr().err


def test_tasks_of_a_server_have_configurations(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValueError, match="PushCube"):
        load("PushCube", "bc")
    monkeypatch.setitem(SERVED, "PushCube-v0", (50, 5.0))
    config = load("PushCube", "bc").but(task_options={"rate": 10})
    assert (config.task, config.steps) == ("PushCube-v0", 100)
    with pytest.raises(ValueError, match="no algorithm is known"):
        load("PushCube")


def test_damaged_files_of_a_run_are_named(tmp_path: Path) -> None:
    """After a power cut or a full disk, files may be empty."""
    run = Run(tmp_path / "seed-0")
    run.begin(load("NeedleReach", "dagger"), resume=False)
    (run.path / "best.zip").write_bytes(b"")
    with pytest.raises(ValueError, match=r"best\.zip.*damaged"):
        run.policy()
    (run.path / "config.json").write_bytes(b"")
    with pytest.raises(ValueError, match=r"config\.json.*damaged"):
        _ = run.config


class Harm:
    """Writes a file when it is loaded by pickle."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return Path.write_text, (self.path, "harm")


def test_files_that_run_code_need_trust(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    harm = tmp_path / "harm"
    run = Run(tmp_path / "seed-0")
    run.begin(load("NeedleReach", "her"), resume=False)
    code = base64.b64encode(cloudpickle.dumps(Harm(harm))).decode()
    data = json.dumps({"policy_class": {":type:": "Harm", ":serialized:": code}})
    with zipfile.ZipFile(run.path / "best.zip", "w") as archive:
        archive.writestr("data", data)
    for command in ("evaluate", "export"):
        assert main([command, str(run.path)]) == 2
        assert "--trust" in capsys.readouterr().err
    assert not harm.exists()
    assert main(["evaluate", "--trust", str(run.path)]) == 2
    assert harm.exists()
    checkpoint = run.path / "checkpoint"
    checkpoint.mkdir()
    with pytest.raises(ValueError, match=r"checkpoint can run any code.*--trust"):
        run.check(load("NeedleReach", "her"), resume=True)


def test_files_of_own_algorithms_run_no_code(tmp_path: Path, server: str) -> None:
    harm = tmp_path / "harm"
    run = train(small("dagger", epochs=1), 0, out=tmp_path, server=server, say=quietly)
    torch.save({"policy": Harm(harm)}, run.path / "checkpoint" / "learner.pt")
    torch.save({"policy": Harm(harm)}, run.path / "best.zip")
    with pytest.raises(ValueError, match=r"best\.zip.*damaged"):
        run.policy()
    config = small("dagger", epochs=1)
    with pytest.raises(ValueError, match=r"checkpoint.*damaged"):
        train(config, 0, out=tmp_path, server=server, resume=True, say=quietly)
    assert not harm.exists()


def test_a_refused_option_leaves_no_folder(tmp_path: Path, server: str) -> None:
    """The corrected command can use the same folder."""
    config = load("NeedleReach", "bc").but(task_options={"foo": 1})
    with pytest.raises(ValueError, match="foo"):
        train(config, 0, out=tmp_path, server=server, say=quietly)
    assert not list(tmp_path.iterdir())


def test_a_missing_extra_is_named() -> None:
    code = "import sys; sys.modules['stable_baselines3'] = None; import trocar.rl"
    ended = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert "[rl]" in ended.stderr
