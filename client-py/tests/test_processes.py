"""Several processes: interrupts, lost servers, forks, and the private server of a process tree."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from conftest import Script, alive, eventually, hear, left_behind, say, state
from test_env import constant, make, same
from test_vector import make_vec

import trocar

PATIENT = """
    import sys, gymnasium as gym, numpy as np, trocar
    print("ready")
    input()
    try:
        {wait}
    except KeyboardInterrupt:
        print("interrupted")
    input()
"""

STEPPING = """
    import sys, gymnasium as gym, numpy as np, trocar
    env = gym.make("trocar/NeedleReach-v0", server="{server}").unwrapped
    env.reset(seed=4)
    action = np.full(5, 0.25, np.float32)
    print("ready")
    input()
    try:
        env.step(action)
    except KeyboardInterrupt:
        print("interrupted")
    input()
    print(env.step(action)[0]["observation"].tobytes().hex())
    env.close()
"""


def pause(server: trocar.Server) -> None:
    """Stops every thread of a server, and waits until they have stopped."""
    assert server.pid is not None
    os.kill(server.pid, signal.SIGSTOP)
    threads = Path(f"/proc/{server.pid}/task")
    eventually(lambda: all(state(thread) == "T" for thread in threads.iterdir()))


def resume(server: trocar.Server) -> None:
    assert server.pid is not None
    os.kill(server.pid, signal.SIGCONT)


def interrupt_while_waiting(process: subprocess.Popen[str]) -> None:
    """Lets the script go on into its wait, and interrupts it there."""
    say(process)
    # The wait begins at once; were it not reached yet, the test would still have to pass.
    time.sleep(0.3)
    process.send_signal(signal.SIGINT)
    assert hear(process) == "interrupted"


def test_ctrl_c_interrupts_a_waiting_step_and_the_next_works(
    own_server: trocar.Server, script: Script
) -> None:
    process = script(STEPPING.format(server=own_server.name))
    assert hear(process) == "ready"
    pause(own_server)
    interrupt_while_waiting(process)
    resume(own_server)
    say(process)
    # The interrupted step was carried out, and its reply does not stand for that of the next.
    env = make("NeedleReach-v0", own_server.name)
    env.reset(seed=4)
    action = np.full(5, 0.25, np.float32)
    env.step(action)
    assert hear(process) == env.step(action)[0]["observation"].tobytes().hex()
    env.close()
    assert process.wait() == 0


@pytest.mark.parametrize(
    "wait",
    [
        'gym.make("trocar/NeedleReach-v0", server="{server}")',
        'trocar.status("{server}")',
    ],
)
def test_ctrl_c_interrupts_other_waits(
    wait: str, own_server: trocar.Server, script: Script
) -> None:
    process = script(PATIENT.format(wait=wait.format(server=own_server.name)))
    assert hear(process) == "ready"
    pause(own_server)
    interrupt_while_waiting(process)
    resume(own_server)
    say(process)
    assert process.wait() == 0
    eventually(lambda: own_server.status()["sessions"] == [])


def test_interrupted_receive_can_be_repeated(own_server: trocar.Server, script: Script) -> None:
    process = script(
        f"""
        import gymnasium as gym, numpy as np, trocar
        envs = gym.make_vec("trocar/EcmReach-v0", num_envs=2, server="{own_server.name}")
        envs.reset(seed=0)
        print("ready")
        input()
        envs.send(np.ones((1, 3)), [1])
        try:
            envs.recv()
        except KeyboardInterrupt:
            print("interrupted")
        input()
        print(envs.recv()[4]["env_id"].tolist())
        envs.close()
        """
    )
    assert hear(process) == "ready"
    pause(own_server)
    interrupt_while_waiting(process)
    resume(own_server)
    say(process)
    assert hear(process) == "[1]"
    assert process.wait() == 0


def test_a_server_does_not_outlive_the_process_that_started_it(script: Script) -> None:
    process = script(
        """
        import trocar
        server = trocar.Server(threads=1).start()
        print(server.name)
        print(server.pid)
        input()
        """
    )
    name, pid = hear(process), int(hear(process))
    assert alive(pid)
    process.kill()
    process.wait()
    eventually(lambda: not alive(pid))
    eventually(lambda: left_behind(name) == [])


def test_a_killed_server_is_lost_to_waiting_clients_and_a_new_one_serves_them(
    script: Script,
) -> None:
    server = trocar.Server(threads=1).start()
    process = script(
        f"""
        import gymnasium as gym, numpy as np, trocar
        env = gym.make("trocar/NeedleReach-v0", server="{server.name}").unwrapped
        bystander = gym.make("trocar/NeedleReach-v0", server="{server.name}").unwrapped
        env.reset(seed=4)
        bystander.reset(seed=4)
        print("ready")
        input()
        try:
            env.step(np.zeros(5))
        except trocar.ServerLost as error:
            print(type(error).__name__)
        input()
        first = env.reset(seed=4)[0]
        try:
            bystander.step(np.zeros(5))
        except trocar.ServerLost as error:
            print(type(error).__name__)
        bystander.reset()
        env.step(np.zeros(5))
        env.close()
        bystander.close()
        """
    )
    assert hear(process) == "ready"
    pause(server)
    say(process)
    time.sleep(0.3)
    assert server.pid is not None
    os.kill(server.pid, signal.SIGKILL)
    assert hear(process) == "ServerLost"
    server.stop()
    with trocar.Server(name=server.name, threads=1):
        say(process)
        assert hear(process) == "ServerLost"
        assert process.wait() == 0
    assert left_behind(server.name) == []


def test_a_stopped_server_tells_its_clients() -> None:
    with trocar.Server(threads=1) as server:
        env = make("EcmReach-v0", server.name)
        env.reset(seed=0)
    with pytest.raises(trocar.ServerLost, match="shut down"):
        env.step(np.zeros(3))
    with pytest.raises(trocar.errors.NoServer):
        env.reset()
    env.close()
    assert left_behind(server.name) == []


def test_a_killed_client_leaves_the_others_bits_alone(
    own_server: trocar.Server, script: Script
) -> None:
    process = script(STEPPING.format(server=own_server.name))
    assert hear(process) == "ready"
    envs, expected = (
        make_vec("EcmReach-v0", own_server.name),
        make_vec("EcmReach-v0", own_server.name),
    )
    assert len(own_server.status()["sessions"]) == 3
    envs.reset(seed=0)
    expected.reset(seed=0)
    actions = constant(envs, 0.1)
    process.kill()
    for _ in range(40):
        assert same(envs.step(actions)[0], expected.step(actions)[0])
    eventually(lambda: len(own_server.status()["sessions"]) == 2)
    envs.close()
    expected.close()


def test_a_forked_child_opens_a_session_of_its_own(server: str, script: Script) -> None:
    process = script(
        f"""
        import os, gymnasium as gym, numpy as np, trocar
        env = gym.make("trocar/NeedleReach-v0", server="{server}").unwrapped
        other = gym.make("trocar/NeedleReach-v0", server="{server}").unwrapped
        start = env.reset(seed=4)[0]["observation"]
        other.reset(seed=4)
        action = np.full(5, 0.25, np.float32)
        child = os.fork()
        if child == 0:
            try:
                env.step(action)
            except trocar.errors.ForkedError as error:
                assert str(os.getppid()) in str(error), error
            else:
                raise AssertionError("the child stepped its parent's session")
            assert (env.reset(seed=4)[0]["observation"] == start).all()
            env.step(-action)
            del other
            env.close()
            os._exit(0)
        assert os.waitpid(child, 0)[1] == 0
        for _ in range(10):
            one, two = env.step(action)[0], other.step(action)[0]
            assert (one["observation"] == two["observation"]).all()
        env.close()
        other.close()
        print("done")
        """
    )
    assert hear(process) == "done"
    assert process.wait() == 0


WORKERS = """
    import multiprocessing, os, sys, gymnasium as gym, trocar

    def work(index, queue, go):
        env = gym.make("trocar/NeedleReach-v0")
        env.reset(seed=index)
        env.step(env.action_space.sample())
        queue.put(trocar.status()["pid"])
        while not go.wait(0.1) and multiprocessing.parent_process().is_alive():
            pass
        env.close()

    if __name__ == "__main__":
        context = multiprocessing.get_context("{method}")
        queue, go = context.Queue(), context.Event()
        workers = [context.Process(target=work, args=(i, queue, go)) for i in range(8)]
        for worker in workers:
            worker.start()
        pids = {{queue.get() for _ in workers}}
        status = trocar.status()
        print(*pids, status["name"], len(status["sessions"]))
        if input() == "end":
            go.set()
            for worker in workers:
                worker.join()
                assert worker.exitcode == 0
"""

ASYNC = """
    import gymnasium as gym, trocar

    def make():
        return gym.make("trocar/NeedleReach-v0")

    if __name__ == "__main__":
        envs = gym.vector.AsyncVectorEnv([make] * 8, context="{method}")
        envs.reset(seed=0)
        for _ in range(3):
            envs.step(envs.action_space.sample())
        status = trocar.status()
        print(status["pid"], status["name"], len(status["sessions"]))
        if input() == "end":
            envs.close()
"""


@pytest.mark.parametrize("how_it_ends", ["end", "kill"])
@pytest.mark.parametrize("method", ["fork", "spawn"])
@pytest.mark.parametrize("code", [WORKERS, ASYNC], ids=["processes", "async"])
def test_a_process_tree_shares_one_private_server_which_ends_with_it(
    code: str, method: str, how_it_ends: str, script: Script
) -> None:
    process = script(code.format(method=method))
    *pids, name, sessions = hear(process).split()
    assert len(pids) == 1, "one server for all"
    assert int(sessions) == 8
    assert alive(int(pids[0]))
    if how_it_ends == "end":
        say(process, "end")
        assert process.wait() == 0
    else:
        process.kill()
    eventually(lambda: not alive(int(pids[0])))
    eventually(lambda: left_behind(name) == [])


USER = """
import gymnasium as gym, time, trocar
env = gym.make("trocar/NeedleReach-v0")
env.reset(seed=0)
print(trocar.status()["pid"], trocar.status()["name"], flush=True)
end = time.monotonic() + 5
while time.monotonic() < end:
    if env.step(env.action_space.sample())[3]:
        env.reset()
print("went on", flush=True)
"""

DAEMON = """
import os, trocar
if os.fork(): os._exit(0)
os.setsid()
if os.fork(): os._exit(0)
exec({user!r})
"""

LAUNCHER = """
import os, subprocess, sys, trocar
subprocess.Popen([sys.executable, "-c", {user!r}], start_new_session=True)
os._exit(0)
"""


@pytest.mark.parametrize("code", [DAEMON, LAUNCHER], ids=["daemon", "launcher"])
def test_a_private_server_outlives_the_process_that_imported_trocar_first(
    code: str, script: Script
) -> None:
    process = script(code.format(user=USER))
    assert process.wait() == 0, "the first process is gone"
    assert process.stdout is not None
    pid, name = process.stdout.readline().split()
    assert process.stdout.readline().strip() == "went on"
    eventually(lambda: not alive(int(pid)))
    eventually(lambda: left_behind(name) == [])


def test_a_variable_names_the_server_where_no_argument_does(server: str, script: Script) -> None:
    process = script("import trocar; print(trocar.status()['name'])", TROCAR_SERVER=server)
    assert hear(process) == server


def test_the_interpreter_ends_cleanly_with_environments_and_views_open(
    own_server: trocar.Server, script: Script
) -> None:
    process = script(
        f"""
        import gymnasium as gym, numpy as np, trocar
        env = gym.make("trocar/NeedleReach-v0", server="{own_server.name}", copy=False).unwrapped
        envs = gym.make_vec(
            "trocar/EcmReach-v0", num_envs=2, server="{own_server.name}", copy=False
        )
        view = env.reset(seed=0)[0]
        views = envs.reset(seed=0)[0]
        envs.send(np.zeros((1, 3)), [0])
        print("done")
        """
    )
    assert hear(process) == "done"
    assert process.wait() == 0
    assert own_server.status()["sessions"] == []


RELATIVE = """
import os, trocar
os.chdir("/")
with trocar.Server(threads=1) as server:
    print(server.status()["name"] == server.name)
print(trocar.status()["name"])
"""


def test_a_relative_path_of_the_program_survives_a_change_of_folder(script: Script) -> None:
    relative = os.path.relpath(trocar.binary())
    process = script(RELATIVE, TROCAR_BINARY=relative)
    assert hear(process) == "True"
    assert hear(process).startswith("private-")
    assert process.wait() == 0


IGNORES_CHILDREN = """
import signal, trocar
signal.signal(signal.SIGCHLD, signal.SIG_IGN)
for start in (trocar.Server(threads=1).start, trocar.status):
    try:
        start()
    except trocar.errors.LaunchError as error:
        print(str(error).replace("\\n", " "))
"""


def test_a_parent_that_ignores_sigchld_learns_why_a_server_did_not_start(
    script: Script, tmp_path: Path
) -> None:
    program = tmp_path / "trocar"
    program.write_text("#!/bin/sh\necho no space is left for the log >&2\nexit 3\n")
    program.chmod(0o755)
    process = script(IGNORES_CHILDREN, TROCAR_BINARY=str(program))
    for _ in range(2):
        said = hear(process)
        assert "unknown status, since this process ignores SIGCHLD" in said
        assert "no space is left for the log" in said
    assert process.wait() == 0
