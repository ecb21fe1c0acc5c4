"""Where recordings go: a file, a viewer that listens, or a viewer of their own on this machine."""

from __future__ import annotations

import socket
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from fgrecon.errors import InvalidInputError
from fgrecon.files import write_bytes

__all__ = ["APPLICATION", "LOOPBACK", "send_recording", "start_viewer", "viewer_command", "write_recording"]

APPLICATION = "fgrecon"
"""First part of the application that a recording names; the second is the recording's own name. Viewers keep one layout
per application, and ours zooms to the vehicle: two recordings in one viewer must not share it."""

LOOPBACK = "127.0.0.1"
"""Address that every server listens on unless told otherwise; rerun's own default is all addresses."""

_PATIENCE = 15.0  # seconds for a viewer to start listening
Log = Callable[[Any], None]


def write_recording(path: str | Path, log: Log, blueprint: Any) -> Path:
    """Write what `log` sends into a stream to a `.rrd` file, whole or not at all.

    Args:
        path: File to write.
        log: Called with the `rerun.RecordingStream`.
        blueprint: Layout for the viewer.

    Raises:
        InvalidInputError: The file cannot be written.
    """
    import rerun as rr  # on use: importing fgrecon must not import rerun

    stream = rr.RecordingStream(f"{APPLICATION}: {Path(path).stem}")
    with tempfile.TemporaryDirectory() as folder:
        part = Path(folder) / "recording.rrd"
        stream.save(part, default_blueprint=blueprint)
        log(stream)
        stream.disconnect()
        return write_bytes(path, part.read_bytes())


def send_recording(name: str, log: Log, blueprint: Any, address: str) -> None:
    """Send what `log` sends into a stream to a viewer that listens.

    Args:
        name: Name of the recording.
        log: Called with the `rerun.RecordingStream`.
        blueprint: Layout for the viewer.
        address: `host:port`, or rerun's own `rerun+http://host:port/proxy`.

    Raises:
        InvalidInputError: Nobody listens there.
    """
    import rerun as rr

    host, port = _host_and_port(address)
    if not _listens(host, port):
        fix = f"Start a viewer there first: rerun --bind {LOOPBACK} --port {port}."
        raise InvalidInputError("connect", address, fix)
    stream = rr.RecordingStream(f"{APPLICATION}: {name}")
    stream.connect_grpc(f"rerun+http://{host}:{port}/proxy", default_blueprint=blueprint)
    log(stream)
    stream.flush()
    stream.disconnect()


def viewer_command(*arguments: str, bind: str = LOOPBACK) -> list[str]:
    """The command line that runs rerun's viewer, its servers bound to an address."""
    import sys

    return [sys.executable, "-m", "rerun_cli", "--bind", bind, *arguments]


def start_viewer(bind: str = LOOPBACK) -> str:
    """Start a viewer that outlives this process, and wait until it listens.

    Returns:
        Its address, `host:port`.

    Raises:
        InvalidInputError: It does not start.
    """
    with socket.socket() as probe:
        probe.bind((bind, 0))
        port = int(probe.getsockname()[1])
    viewer = subprocess.Popen(  # noqa: S603 - our own command line
        viewer_command("--port", str(port), "--expect-data-soon", bind=bind),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    until = time.monotonic() + _PATIENCE
    while time.monotonic() < until and viewer.poll() is None:
        if _listens(bind, port):
            return f"{bind}:{port}"
        time.sleep(0.1)
    if viewer.poll() is None:
        viewer.terminate()
    fix = "Use --save FILE.rrd, and open the file where there is a display."
    raise InvalidInputError("spawn", "the viewer does not start here", fix)


def _host_and_port(address: str) -> tuple[str, int]:
    """Host and port of `host:port` or `rerun+http://host:port/proxy`."""
    host, _, port = address.removeprefix("rerun+http://").removesuffix("/proxy").rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise InvalidInputError("connect", address, "Give host:port, such as 127.0.0.1:9876.")
    return host, int(port)


def _listens(host: str, port: int) -> bool:
    try:
        with socket.create_connection((host, port), timeout=2.0):
            return True
    except OSError:
        return False
