"""A Ray cluster of two nodes on this machine, as `ray start` makes it, and ways to kill what works there."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import uuid
from contextlib import suppress
from pathlib import Path

_MARK = "FGRECON_TEST_CLUSTER"


class RayCluster:
    """Two nodes of a processor each; all its processes carry a mark in their environment, and no others are touched."""

    def __init__(self) -> None:
        """Start a head and a second node."""
        self._folder = tempfile.mkdtemp(prefix="fgr")  # names of sockets have 107 characters at most
        self._mark = uuid.uuid4().hex
        self.address = f"127.0.0.1:{_free_port()}"
        self._ray(
            "--head", f"--port={self.address.split(':')[1]}", f"--temp-dir={self._folder}", "--include-dashboard=false"
        )
        self._ray(f"--address={self.address}")

    def _ray(self, *options: str) -> None:
        ray = [str(Path(sys.executable).with_name("ray")), "start", *options, "--num-cpus=1", "--disable-usage-stats"]
        environment = os.environ | {_MARK: self._mark, "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "1"}
        done = subprocess.run(ray, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr

    def actors(self) -> list[int]:
        """Processes in which actors are."""
        return [process for process in self._processes() if b"ray::_Solver" in _read(process, "cmdline")]

    def _processes(self) -> list[int]:
        wanted = f"{_MARK}={self._mark}".encode()
        every = [int(path.name) for path in Path("/proc").iterdir() if path.name.isdecimal()]
        return [process for process in every if wanted in _read(process, "environ").split(b"\0")]

    def stop(self) -> None:
        """End every process of it."""
        for sign in (signal.SIGTERM, signal.SIGKILL):
            for process in self._processes():
                kill(process, sign)
            time.sleep(2.0)
        shutil.rmtree(self._folder, ignore_errors=True)


def workers_of(run: int) -> list[int]:
    """The worker processes of a local run."""
    children = [Path("/proc", str(run), "task", str(run), "children").read_text(encoding="ascii").split()]
    return [int(child) for child in children[0] if b"spawn_main" in _read(int(child), "cmdline")]


def kill(process: int, sign: int = signal.SIGKILL) -> None:
    """Kill a process, if it is still there."""
    with suppress(ProcessLookupError):
        os.kill(process, sign)


def _read(process: int, name: str) -> bytes:
    try:
        return Path("/proc", str(process), name).read_bytes()
    except OSError:
        return b""


def _free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])
