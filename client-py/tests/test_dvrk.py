"""Scripts for a real da Vinci run unchanged, in a world in lock-step and at its own pace."""

from __future__ import annotations

import json
import math
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import trocar
from trocar import dvrk
from trocar.dvrk import crtk, kdl
from trocar.errors import ArmIsDriven, InvalidOption, UnknownArm, Unsupported

SCRIPTS = Path(__file__).parent / "scripts"

EXAMPLES = Path(__file__).parents[1] / "examples" / "dvrk"

HOME = np.array([0.0, 0.0, 0.12, 0.0, 0.0, 0.0])

TICK = 1 / 240


def run(server: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Runs ``python -m trocar.dvrk``."""
    command = [sys.executable, "-W", "error", "-m", "trocar.dvrk", "--server", server, *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


@pytest.fixture
def world(server: str) -> Iterator[dvrk.World]:
    """A world of NeedleReach in lock-step."""
    with dvrk.session("NeedleReach-v0", server=server) as opened:
        yield opened


@pytest.fixture
def psm(world: dvrk.World) -> dvrk.psm:
    """Its arm, homed."""
    arm: Any = dvrk.psm(crtk.ral("test"), "PSM1")
    assert world.live.speed is None
    assert arm.enable(10)
    assert arm.home(10)
    return arm  # type: ignore[no-any-return]


def away(*steps: float) -> Any:
    """Joints this far from home, the first ones first."""
    return HOME + np.array([*steps, *[0.0] * (6 - len(steps))])


def took(world: dvrk.World, act: Any) -> float:
    """How long something takes in the script's time, s."""
    start = world.now()
    assert act()
    return world.now() - start


@pytest.mark.parametrize("speed", ["max", "20"])
def test_a_script_like_the_arm_test_of_dvrk_runs_unchanged(server: str, speed: str) -> None:
    """Homing, ``servo_jp``, ``move_jp``, ``servo_cp``, ``move_cp`` and the jaw."""
    done = run(
        server, "--task", "NeedleReach-v0", "--speed", speed, f"{SCRIPTS}/move_arm.py", "-a", "PSM1"
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    lines = done.stdout.splitlines()
    # At a pace, two readings that the system parts are of two moments, as on a robot.
    assert sum("!" in line for line in lines) <= (0 if speed == "max" else 25)
    assert lines[-1] == "shut down"
    times = {line.split(": ")[0]: float(line.split(": ")[1]) for line in lines if ": " in line}
    # The closed form; in lock-step each move ends within two ticks.
    expected = {"move_jp": (2.276, 3), "move_cp": (7.151, 6), "jaw": (2.333, 4)}
    for name, (seconds, moves) in expected.items():
        assert times[name] >= seconds - 1e-3
        if speed == "max":
            assert times[name] <= seconds + moves * 2 * TICK + 1e-3
    if speed == "max":
        assert times["servo_jp"] == pytest.approx(5.0, abs=1e-6)


def test_a_needle_is_picked_by_the_commands_of_a_robot_alone(server: str) -> None:
    """And its goal is reached, which the script learns beside."""
    for seed in ("0", "1", "2"):
        options = ["--task", "NeedlePick-v0", "--seed", seed, "--frames", "world"]
        done = run(server, *options, f"{SCRIPTS}/pick_needle.py")
        assert done.returncode == 0, done.stderr
        assert done.stdout.splitlines()[-1] == "reward 0.0, success True"
        assert done.stderr == ""


@pytest.mark.parametrize(
    ("script", "arguments", "says"),
    [
        ("home_and_move", ["PSM1"], "PSM1 is at [0.0, 0.0, 0.12, 0.0, 0.0, 0.0]"),
        ("servo_circle", ["PSM1"], "PSM1 was never more than 0.0 mm away from its circle"),
        ("dip_and_lift", ["PSM1", "0.02"], "PSM1 is back within 0.0 mm, its jaw at"),
    ],
)
def test_examples_run(server: str, script: str, arguments: list[str], says: str) -> None:
    """The same files run on a robot."""
    done = run(server, "--task", "NeedleReach-v0", f"{EXAMPLES}/{script}.py", *arguments)
    assert (done.returncode, done.stderr) == (0, "")
    assert says in done.stdout


@pytest.mark.parametrize(("speed", "seed"), [("max", 0), ("max", 6), ("10", 0)])
def test_a_needle_is_laid_down_picked_handed_over_and_laid_down(
    server: str, speed: str, seed: int
) -> None:
    """By an example: the commands of a robot alone, in lock-step and at a pace."""
    world = ["--task", "NeedleRegrasp-v0", "--homing", "in_place", "--frames", "world"]
    options = [*world, "--speed", speed, "--seed", str(seed)]
    done = run(server, *options, f"{EXAMPLES}/hand_over.py")
    assert (done.returncode, done.stderr) == (0, "")
    assert [line.split(" at ")[0] for line in done.stdout.splitlines()] == [
        "PSM1 has laid the needle down",
        "PSM2 has the needle",
        "PSM2 has laid the needle down",
    ]


def test_what_a_script_did_is_recorded_and_plays_again(server: str, tmp_path: Path) -> None:
    """Bit by bit, as a film if that is wanted."""
    recording, film = tmp_path / "pick.trocar", tmp_path / "pick.gif"
    world = ["--task", "NeedlePick-v0", "--frames", "world", "--record", str(recording)]
    assert run(server, *world, f"{SCRIPTS}/pick_needle.py").returncode == 0
    command = [trocar.binary(), "replay", str(recording), "--json", "--out", str(film)]
    replayed = subprocess.run(command, capture_output=True, text=True, check=True)
    (row,) = [json.loads(line) for line in replayed.stdout.splitlines()]
    assert (row["task"], row["success"], row["failed"]) == ("NeedlePick-v0", True, False)
    assert row["snapshots"] >= 5
    assert film.stat().st_size > 10_000


@pytest.mark.parametrize("word", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_script_and_writes_its_recording(
    server: str, tmp_path: Path, word: signal.Signals
) -> None:
    """Batch systems and containers end programs by SIGTERM."""
    target, script = tmp_path / "recording.trocar", tmp_path / "forever.py"
    script.write_text("import time\nprint('ready', flush=True)\nwhile True:\n    time.sleep(0.1)\n")
    command = [sys.executable, "-m", "trocar.dvrk", "--server", server, "--record", str(target)]
    with subprocess.Popen([*command, str(script)], stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == "ready\n"
        child.send_signal(word)
        child.wait(30)
    assert target.stat().st_size > 0


def test_a_recording_that_cannot_be_written_is_refused_at_once(server: str, tmp_path: Path) -> None:
    """The script does not run, and one line names the path."""
    script = tmp_path / "script.py"
    script.write_text("print('ran')\n")
    for target in (tmp_path / "no" / "folder.trocar", tmp_path):
        process = run(server, "--record", str(target), str(script))
        assert process.returncode == 2
        assert "ran" not in process.stdout
        assert str(target) in process.stderr.splitlines()[-1]
    command = [sys.executable, "-m", "trocar.dvrk.deploy", "NeedleReach", "--log", "/proc"]
    process = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert process.returncode == 2
    assert "--log" in process.stderr
    assert "Traceback" not in process.stderr


def test_a_world_comes_back_to_what_was_kept(psm: Any, world: dvrk.World) -> None:
    """In the middle of a move, which goes on; time goes on as well."""
    handle = psm.move_jp(away(0.5))
    world.sleep(0.2)
    kept, begun = world.live.snapshot(), psm.measured_jp()[0]
    assert handle.wait()
    ended = psm.measured_jp()
    np.testing.assert_array_equal(ended[0], away(0.5))
    world.live.restore(kept)
    back = psm.measured_jp()
    np.testing.assert_array_equal(back[0], begun)
    assert back[1] >= ended[1]
    world.look()
    assert psm.is_busy()
    assert world.wait(lambda: not psm.is_busy(), 5.0)
    np.testing.assert_array_equal(psm.measured_jp()[0], ended[0])


def test_the_same_script_gives_the_same_numbers(server: str) -> None:
    """In lock-step, to the last bit."""
    runs = [run(server, f"{SCRIPTS}/random_moves.py") for _ in range(2)]
    assert runs[0].returncode == 0, runs[0].stderr
    assert runs[0].stdout == runs[1].stdout
    assert len(runs[0].stdout.splitlines()) == 50


def test_the_command_line_says_what_is_wrong(server: str) -> None:
    """A task or a server that there is not."""
    done = run(server, "--task", "NeedleReach-v9", f"{SCRIPTS}/random_moves.py")
    assert done.returncode == 1
    assert "NeedleReach-v9" in done.stderr
    assert "Traceback" not in done.stderr
    done = run("no-such-server", f"{SCRIPTS}/random_moves.py")
    assert "trocar serve --name no-such-server" in done.stderr


@pytest.mark.parametrize("name", ["nowhere.py", "folder"])
def test_a_missing_script_is_one_line(server: str, tmp_path: Path, name: str) -> None:
    (tmp_path / "folder").mkdir()
    process = run(server, str(tmp_path / name))
    assert process.returncode == 1
    assert len(process.stderr.splitlines()) == 1, process.stderr
    assert name in process.stderr
    assert "expected a Python file" in process.stderr


def test_a_script_imports_modules_of_its_own_folder(server: str, tmp_path: Path) -> None:
    """``sys.path[0]`` is the script's folder, as under Python itself."""
    (tmp_path / "lab_poses.py").write_text("ABOVE = 0.12\n")
    script = tmp_path / "main.py"
    script.write_text(
        "import sys\nimport crtk.utils\nfrom crtk.utils import utils\nimport lab_poses\n"
        "print(lab_poses.ABOVE, sys.path[0], crtk.utils is utils)\n"
    )
    process = run(server, str(script))
    assert process.stdout.split() == ["0.12", str(tmp_path.resolve()), "True"], process.stderr


def test_names_are_in_place_only_where_a_script_is_run() -> None:
    """No package of these names is installed."""
    for name in ("crtk", "dvrk"):
        assert name not in sys.modules
    assert time.sleep.__module__ == "time"


def test_readings_have_the_shapes_of_dvrks(psm: Any, world: dvrk.World) -> None:
    """Tuples whose last element is a stamp."""
    time_passes(world, 0.1)
    p, v, f, stamp = psm.measured_js()
    assert (len(p), len(v), len(f)) == (6, 6, 6)
    assert p.dtype == np.float64
    assert stamp > 1e9
    assert abs(world.now() - stamp) < 2 * TICK
    assert psm.setpoint_jp()[0].tolist() == pytest.approx(HOME.tolist())
    assert psm.measured_jv()[0].tolist() == [0.0] * 6
    p, v, f, stamp = psm.jaw.setpoint_js()
    assert (len(p), len(v), len(f)) == (1, 0, 1)
    frame, stamp = psm.measured_cp()
    local, _ = psm.local.measured_cp()
    assert stamp > 0
    assert crtk.numbers_of(frame) == crtk.numbers_of(local)
    for get in (psm.measured_cv, psm.body.measured_cf, psm.spatial.measured_cf):
        numbers, stamp = get()
        assert numbers.shape == (6,)
        assert stamp > 0
    assert psm.body.jacobian()[0].shape == (6, 6)
    assert psm.operating_state() == "ENABLED"
    assert psm.operating_state(extra=True)[1] > 1e9
    assert (psm.is_enabled(), psm.is_homed(), psm.is_busy(), psm.is_disabled()) == (
        *(True, True),
        *(False, False),
    )
    assert psm.name() == "PSM1"


@pytest.mark.parametrize("speed", [None, 20.0])
def test_scripts_connect_enable_home_and_poll(server: str, speed: float | None) -> None:
    """A1, A2 and A6 of dVRK's own scripts, with a PSM and an ECM."""
    for task, name, arm in [("NeedleReach-v0", "PSM1", dvrk.psm), ("EcmReach-v0", "ECM", dvrk.ecm)]:
        with dvrk.session(task, server=server, speed=speed) as world:
            ral = crtk.ral("test")
            driven: Any = arm(ral, name)
            ral.check_connections(5.0)  # A1
            for _ in range(2):  # A2
                assert driven.enable(10)
                assert driven.home(10)
            home = HOME[: len(driven.measured_jp()[0])]
            np.testing.assert_allclose(driven.setpoint_jp()[0], home, rtol=0, atol=1e-9)
            start = world.now()
            assert driven.home(10)
            assert world.now() - start < 0.5
            for goal in (0.1, -0.1, 0.0):  # A6
                joints = np.array(home)
                joints[0] += goal
                handle = driven.move_jp(joints)
                while handle.is_busy():
                    world.sleep(0.01)
                np.testing.assert_allclose(driven.measured_jp()[0], joints, rtol=0, atol=1e-6)


def test_a_script_that_starts_late_finds_its_way(server: str, world: dvrk.World) -> None:
    """B12: in a world whose arm another script has homed, and still drives at first."""
    shared = world.live.id
    first = dvrk.World("NeedleReach-v0", server=server, world=shared)
    late = dvrk.World("NeedleReach-v0", server=server, world=shared)
    try:
        dvrk.use(first)
        homed: Any = dvrk.psm(crtk.ral("first"), "PSM1")
        assert homed.enable(10)
        assert homed.home(10)
        dvrk.use(late)
        arm: Any = dvrk.psm(crtk.ral("late"), "PSM1")
        with pytest.raises(ArmIsDriven, match="PSM1"):
            arm.home(1)
        first.close()
        # Of the arm's driver, `late` knows what its last look told.
        late.look()
        deadline = time.monotonic() + 30.0
        while late.live.status("PSM1")[1] != 0:
            assert time.monotonic() < deadline
            late.look()
        # It has heard of no state yet, and every command is answered.
        again: Any = dvrk.psm(crtk.ral("again"), "PSM1")
        assert again.home(10)
        assert again.is_homed()
        assert again.move_jp(away(0.1)).wait()
        assert again.measured_jp()[0][0] == 0.1
    finally:
        dvrk.use(world)
        first.close()
        late.close()


def test_handles_wait_as_dvrks_do(psm: Any, world: dvrk.World) -> None:
    """For a message that the arm is busy, and one that it is not any more."""
    # To where the arm is: at once.
    assert took(world, lambda: psm.move_jp(HOME).wait()) < 0.1
    goal = away(0.2)
    handle = psm.move_jp(goal)
    assert handle.is_busy()
    assert handle.wait(is_busy=True)
    start = world.now()
    while handle.is_busy():
        time_passes(world, 0.01)
    seconds = 2 * math.sqrt(0.2 / (math.pi / 2))
    assert seconds <= world.now() - start <= seconds + 0.02
    assert psm.measured_jp()[0].tolist() == pytest.approx(goal.tolist())
    # Held, it has ended, and has not reached its goal.
    handle = psm.move_jp(HOME)
    time_passes(world, 0.1)
    psm.hold()
    assert handle.wait()
    assert world.feeds["PSM1"].goal_reached is False
    # The jaw's handle is the arm's.
    assert took(world, lambda: psm.jaw.open().wait()) == pytest.approx(0.577, abs=3 * TICK)
    psm.jaw.close().wait(is_busy=True)
    assert psm.insert_jp(0.1).wait()
    assert psm.setpoint_jp()[0][2] == pytest.approx(0.1)
    assert psm.jaw.setpoint_jp()[0][0] == pytest.approx(math.radians(-20))
    with pytest.raises(RuntimeWarning, match="operating state"):
        crtk.move_handle(world, None).wait()


def time_passes(world: dvrk.World, seconds: float) -> None:
    """As ``time.sleep`` does in a script."""
    world.sleep(seconds)


def test_a_loop_that_never_sleeps_ends(psm: Any) -> None:
    """Readings without end let time pass."""
    psm.move_jp(away(0.1))
    while psm.is_busy():
        pass
    assert psm.measured_jp()[0][0] == pytest.approx(0.1)


def test_what_a_real_arm_does_not_do_this_one_does_not_either(
    world: dvrk.World, capsys: pytest.CaptureFixture[str]
) -> None:
    """Not ready, wrong counts, numbers that are none, lists, arms that there are not."""
    told: list[str] = []
    world._complain = lambda arm, words: told.append(f"{arm}: {words}")
    ral = crtk.ral("test")
    psm: Any = dvrk.psm(ral, "PSM1")
    ral.check_connections(1)
    # Without power: no motion, and the script waits in vain.
    start = world.now()
    assert psm.home(2) is False
    assert not psm.move_jp(HOME).wait(timeout=2)
    assert world.now() - start == pytest.approx(4.0, abs=3 * TICK)
    assert any("arm not ready" in words for words in told)
    assert psm.enable(10)
    assert psm.home(10)
    for numbers, expected in [
        (HOME[:5], ("5 numbers", "expected 6")),
        (np.full(6, np.nan), ("number 0", "NaN")),
        (away(0, 0, math.inf), ("number 2", "inf")),
    ]:
        told.clear()
        assert not psm.move_jp(numbers).wait(timeout=0.1)
        assert all(part in told[0] for part in ("PSM1: error: move_jp", *expected)), told
    with pytest.raises(AttributeError):
        psm.move_jp(HOME.tolist())
    # Out of the limits is clipped, as on the robot.
    assert psm.move_jp(away(math.radians(120))).wait()
    assert psm.setpoint_jp()[0][0] == pytest.approx(math.radians(91), abs=1e-3)

    absent: Any = dvrk.psm(ral, "PSM3")
    with pytest.raises(TimeoutError, match=r"PSM3.*this world has PSM1"):
        ral.check_connections(0.1)
    with pytest.raises(TimeoutError, match="no data received yet"):
        absent.measured_js()
    assert absent.enable(0.1) is False
    with pytest.raises(RuntimeError, match="already has child"):
        ral.create_child("PSM1")
    with pytest.raises(NotImplementedError, match="no ROS"):
        ral.publisher("/x", None)
    with pytest.raises(UnknownArm, match="this world has PSM1"):
        world.live.command("PSM7", "hold")
    assert capsys.readouterr().out == ""


def test_kinematics_are_services(psm: Any) -> None:
    """Whose answers have a word of why there is none."""
    joints = np.array([0.1, -0.2, 0.13, 0.3, 0.2, -0.1])
    frame = psm.forward_kinematics(joints)
    found = psm.inverse_kinematics(joints, frame)
    assert np.abs(found - joints).max() < 1e-9
    _, ok, why = psm.forward_kinematics(np.zeros(7), extra=True)
    assert (ok, "too many joints" in why) == (False, True)


def test_ratio_tool_and_power(psm: Any, world: dvrk.World) -> None:
    """The rest of an arm's interface, and of the system's."""
    psm.trajectory_j_set_ratio(0.5)
    assert psm.trajectory_j_get_ratio() == 0.5
    goal = away(math.radians(10))
    assert took(world, lambda: psm.move_jp(goal).wait()) == pytest.approx(0.943, abs=3 * TICK)
    psm.set_tool_present(False)
    time_passes(world, 0.1)
    assert psm.measured_cp()[1] == 0.0
    assert len(psm.measured_jp()[0]) == 7
    psm.set_tool_present(True)
    system = dvrk.system(psm.ral())
    system.power_off()
    assert psm.wait_for_operating_state("DISABLED", 1)
    system.power_on()
    system.home()
    assert psm.wait_for_busy(is_busy=False, timeout=5)
    assert psm.is_homed()
    console = dvrk.console(psm.ral())
    console.teleop_set_scale(0.3)
    assert console.teleop_get_scale() == 0.3


def test_objects_have_poses_below_their_names(server: str) -> None:
    """In the frame of the world, as its arms have them where that is asked for."""
    with dvrk.session("PegTransfer-v0", server=server, in_world=True) as world:
        ral = crtk.ral("test")
        block: Any = type("block", (), {})()
        crtk.utils(block, ral.create_child("other_block_1"), 1.0).add_measured_cp()
        arm: Any = dvrk.psm(ral, "PSM1")
        ral.check_connections(1)
        pose, stamp = block.measured_cp()
        assert stamp > 1e9
        assert list(pose.p) == world.live.object("other block 1")[:3]
        frame, _ = arm.measured_cp()
        local, _ = arm.local.measured_cp()
        *_, base = world.live.describe("PSM1")
        assert crtk.frame_of(base) * local == frame
        assert 0.5 < frame.p[2] < 1.0


def test_pictures_show_the_world(server: str) -> None:
    """Of the size and the camera that were asked for, and not without having asked."""
    view = {"image_size": (48, 64)}
    with dvrk.session("NeedlePick-v0", server=server, view=view) as world:
        before = world.live.render()
        assert before.shape == (48, 64, 3)
        assert before.dtype == np.uint8
        assert before.std() > 1
        assert world.live.render(depth=True).shape == (48, 64)
        arm: Any = dvrk.psm(crtk.ral("test"), "PSM1")
        assert arm.enable(10)
        assert arm.home(10)
        assert (world.live.render() != before).any()
    with (
        dvrk.session("NeedlePick-v0", server=server) as world,
        pytest.raises(Unsupported, match="open it with one"),
    ):
        world.live.render()


def test_an_arm_has_one_driver(server: str, world: dvrk.World, psm: Any) -> None:
    """Another session in the same world may read, and is refused by name where it commands."""
    client = trocar._trocar.Client.connect(server)
    other = client.open_live("NeedleReach-v0", world=world.live.id)
    other.advance(0)
    assert other.operating_state("PSM1") == ("ENABLED", True, False)
    other.command("PSM1", "hold")
    with pytest.raises(ArmIsDriven, match="PSM1"):
        other.advance(0)
    other.close()
    assert psm.move_jp(HOME).wait()
    with pytest.raises(InvalidOption, match=r"live\.speed"):
        client.open_live("NeedleReach-v0", speed=-1.0)
    with pytest.raises(InvalidOption, match="to_zero"):
        client.open_live("NeedleReach-v0", homing="slowly")


def test_readings_fail_once_the_server_is_gone(own_server: trocar.Server) -> None:
    """With the error of dVRK's clients."""
    with dvrk.session("NeedleReach-v0", server=own_server.name, speed=1.0):
        arm: Any = dvrk.arm(crtk.ral("test"), "PSM1", 0.1)
        arm.measured_js(wait_timeout=1.0)
        own_server.stop()
        with pytest.raises(TimeoutError, match=r"no data for 0\.1 s"):
            arm.measured_js()


def test_the_kdl_shaped_module_has_the_rules_of_pykdl() -> None:
    """Parts are aliases, assignments copy."""
    frame, other = kdl.Frame(kdl.Vector(1, 2, 3)), kdl.Frame()
    frame.p[0] = 5.0
    assert frame.p.x() == 5.0
    other.p = frame.p
    frame.p[0] = 6.0
    assert other.p[0] == 5.0
    other.M.DoRotZ(math.pi / 2)
    assert (other * kdl.Vector(1, 0, 0)) == kdl.Vector(5, 3, 3)
    assert other.Inverse() * other == kdl.Frame()
    rng = np.random.default_rng(0)
    for _ in range(100):
        quaternion = rng.normal(size=4)
        quaternion /= np.linalg.norm(quaternion)
        rotation = kdl.Rotation.Quaternion(*quaternion)
        found = np.array(rotation.GetQuaternion())
        assert abs(found @ quaternion) == pytest.approx(1.0, abs=1e-12)
        assert kdl.Rotation.RPY(*rotation.GetRPY()) == rotation
        angle, axis = rotation.GetRotAngle()
        assert kdl.Rotation.Rot(axis, angle) == rotation
        assert kdl.Equal(rotation.Inverse() * rotation, kdl.Rotation(), 1e-12)
        a, b = kdl.Frame(rotation, kdl.Vector(*rng.normal(size=3))), kdl.Frame(rotation.Inverse())
        assert kdl.addDelta(a, kdl.diff(a, b)) == b
    nine = kdl.Rotation(0, -1, 0, 1, 0, 0, 0, 0, 1)
    assert nine == kdl.Rotation.RotZ(math.pi / 2)
    assert kdl.Rotation(nine.UnitX(), nine.UnitY(), nine.UnitZ()) == nine
    assert nine[1, 0] == 1
    vector = kdl.Vector(3, 4, 0)
    assert vector.Normalize() == 5
    assert kdl.dot(vector, 2 * vector) == pytest.approx(2)
    assert kdl.Vector(1, 0, 0) * kdl.Vector(0, 1, 0) == kdl.Vector(0, 0, 1)
    twist = kdl.Frame(kdl.Vector(0, 0, 1)) * kdl.Twist(kdl.Vector(), kdl.Vector(1, 0, 0))
    assert list(twist) == [0, 1, 0, 1, 0, 0]
    assert np.asarray(vector).tolist() == list(vector)
