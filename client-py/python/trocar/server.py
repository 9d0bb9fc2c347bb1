"""Servers: where their program is, and starting one for a ``with`` block."""

from __future__ import annotations

import os
import secrets
import shutil
import signal
import subprocess
import sysconfig
import tempfile
import time
from pathlib import Path
from types import TracebackType
from typing import IO, Any

from trocar import _trocar
from trocar.errors import LaunchError, NoServer

PATIENCE = 20.0
"""How long a server may take to start or to stop, s."""


def binary() -> str:
    """The path of the ``trocar`` program.

    It is ``$TROCAR_BINARY`` (a relative path starts at the working directory that this process had
    when it imported ``trocar``), else the one that the wheel ``trocar-server`` put beside this
    Python, else the one on the PATH.

    Raises:
        LaunchError: There is none, or the variable names none.
    """
    named = os.environ.get(_trocar.BINARY)
    if named:
        if shutil.which(named) is None:
            what = "there is no such program; name the trocar program, or unset the variable"
            raise LaunchError(f"${_trocar.BINARY} = {named!r}: {what}")
        return _absolute(named)
    schemes = [sysconfig.get_default_scheme(), sysconfig.get_preferred_scheme("user")]
    folders = [sysconfig.get_path("scripts", scheme) for scheme in schemes]
    found = shutil.which("trocar", path=os.pathsep.join(folders)) or shutil.which("trocar")
    if found is None:
        raise LaunchError(
            "the trocar program was not found; install the wheel trocar-server that `make wheels` "
            f"writes, or say in ${_trocar.BINARY} where the program is"
        )
    return found


def _absolute(program: str) -> str:
    """Absolute path of a program, if its name contains a folder; names on the PATH stay as given.

    A relative path stays too, if the working directory was removed.
    """
    try:
        return os.path.abspath(program) if os.sep in program else program
    except FileNotFoundError:
        return program


def _fix_binary() -> None:
    """Makes a relative ``$TROCAR_BINARY`` absolute, for later changes of the working directory.

    Child processes inherit the absolute path.
    """
    named = os.environ.get(_trocar.BINARY)
    if named:
        os.environ[_trocar.BINARY] = _absolute(named)


class Server:
    """A server of one's own, for as long as a ``with`` block lasts.

    Other processes of the same user reach it by its name. It ends with the process that made
    this object, however that ends. What it writes for people goes to the
    file ``log`` (by default a temporary one, which is quoted where the server does not start).

    >>> import gymnasium as gym
    >>> with Server(threads=1) as server:
    ...     env = gym.make("trocar/EcmReach-v0", server=server.name)
    ...     observation, info = env.reset(seed=3)
    ...     env.close()
    """

    def __init__(
        self,
        name: str | None = None,
        *,
        threads: int | None = None,
        max_envs: int | None = None,
        memory: str | None = None,
        idle_limit: str | None = None,
        log: str | os.PathLike[str] | None = None,
    ) -> None:
        """Describes the server; :meth:`start`, or the ``with`` statement, starts it.

        Args:
            name: 1 to 24 letters, digits, ``-`` or ``_``; a unique one if none is given.
            threads: Threads that step environments; as many as there are cores if not given.
            max_envs: Most environments of one session.
            memory: Budget of shared memory, e.g. ``"1GiB"``.
            idle_limit: Time after which an idle session ends, e.g. ``"1h"``.
            log: File for what the server has to say.
        """
        self.name = name if name is not None else f"py-{secrets.token_hex(6)}"
        self._log_path = Path(log) if log is not None else None
        self._log: IO[bytes] | None = None
        self._process: subprocess.Popen[bytes] | None = None
        flags = {
            "--threads": threads,
            "--max-envs": max_envs,
            "--memory": memory,
            "--idle-limit": idle_limit,
        }
        # However this process ends, the server does not outlive it.
        self._arguments = ["serve", "--name", self.name, "--follow", str(os.getpid())]
        for flag, value in flags.items():
            if value is not None:
                self._arguments += [flag, str(value)]

    @property
    def pid(self) -> int | None:
        """Its process id, while it runs."""
        return self._process.pid if self._process is not None else None

    def start(self) -> Server:
        """Starts the server and waits until it answers.

        Raises:
            LaunchError: It did not come up, for instance because the name is in use.
        """
        if self._process is not None:
            return self
        program = binary()
        self._log = self._log_path.open("w+b") if self._log_path else tempfile.TemporaryFile()
        try:
            self._process = subprocess.Popen(
                [program, *self._arguments],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=self._log,
                # Ctrl-C in a terminal is for the trainers.
                start_new_session=True,
            )
        except OSError as error:
            self._forget()
            raise LaunchError(f"server {self.name!r} could not be started: {error}") from error
        try:
            self._wait_until_ready(self._process)
        except BaseException:
            self.stop()
            raise
        return self

    def stop(self) -> None:
        """Ends the server in order; its clients get ``ServerLost``. Twice does no harm."""
        process = self._process
        if process is None:
            return
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        self._forget()

    def status(self) -> dict[str, Any]:
        """Its clients and sessions, and how fast it runs, as ``trocar status --json`` prints it."""
        return _trocar.Client.connect(self.name).status()

    def __enter__(self) -> Server:
        return self.start()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stop()

    def __repr__(self) -> str:
        state = "not running" if self._process is None else f"process {self._process.pid}"
        return f"<trocar server {self.name!r}, {state}>"

    def _wait_until_ready(self, process: subprocess.Popen[bytes]) -> None:
        deadline = time.monotonic() + PATIENCE
        while True:
            if process.poll() is not None:
                # Popen reports 0 if SIGCHLD is ignored, since the kernel then keeps no status.
                is_ignored = signal.getsignal(signal.SIGCHLD) is signal.SIG_IGN
                unknown = "an unknown status, since this process ignores SIGCHLD"
                status = unknown if is_ignored else f"status {process.returncode}"
                raise LaunchError(f"server {self.name!r} ended with {status}: {self._said()}")
            try:
                client = _trocar.Client.connect(self.name)
            except NoServer:
                pass
            else:
                if client.pid == process.pid:
                    return
            if time.monotonic() > deadline:
                raise LaunchError(f"server {self.name!r} did not come up: {self._said()}")
            time.sleep(0.01)

    def _said(self) -> str:
        if self._log is None:
            return ""
        self._log.seek(0)
        return self._log.read().decode(errors="replace").strip()

    def _forget(self) -> None:
        self._process = None
        if self._log is not None:
            self._log.close()
            self._log = None


_fix_binary()
