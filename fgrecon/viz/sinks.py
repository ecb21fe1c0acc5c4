"""Destinations of recordings: a file, a viewer that listens, or a viewer of their own on this machine."""

from __future__ import annotations

import importlib.util
import os
import re
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fgrecon.core.errors import InvalidInputError, MissingPackageError
from fgrecon.core.text import distinct, whole_text
from fgrecon.io.files import check_output, replacing

APPLICATION = "fgrecon"
"""First part of the application that a recording names; the second is the recording's own name. Viewers keep one layout
per application, and ours zooms to the vehicle: two recordings in one viewer must not share it."""

LOOPBACK = "127.0.0.1"
"""Address that every server listens on unless another is given; rerun's own default is all addresses."""

_ALL = ("0.0.0.0", "::")  # noqa: S104 - what users may give
_ANYWHERE = ("192.0.2.1", 9)  # an address of documentation, which is no machine's

_PATIENCE = 15.0  # seconds for a viewer to start listening
_SETTLING = 1.0  # seconds for it to open its window


@dataclass(frozen=True)
class Recording:
    """What a recording will hold; nothing is made before it is written or sent somewhere.

    Attributes:
        make: Makes everything, and returns what sends it into a `rerun.RecordingStream`.
        layout: Makes the `rerun.blueprint.Blueprint` for the viewer.
        application: First part of the application that it names.
        in_memory: Whether a file of it is made in memory, which is faster; a video's goes there bit by bit.
    """

    make: Callable[[], Callable[[Any], None]]
    layout: Callable[[], Any]
    application: str = APPLICATION
    in_memory: bool = True

    def write(self, path: str | Path) -> Path:
        """Write it to a `.rrd` file, whole or not at all.

        Raises:
            InvalidInputError: The file cannot be written.
        """
        return self.begin(path)()

    def begin(self, path: str | Path) -> Callable[[], Path]:
        """Make all that `write` writes, and leave it to later to encode and write it: that takes longer.

        Returns:
            What does so, puts the file in its place and returns its path; it may be called in another thread. It raises
            an InvalidInputError where the file could not be written.
        """
        with ExitStack() as started:  # a path that cannot be written to stops all before anything is made
            part = started.enter_context(replacing(path))
            send, layout = self.make(), self.layout()
            rest = started.pop_all()

        def finish() -> Path:
            import rerun as rr  # on use: importing fgrecon must not import rerun

            with rest:
                stream = rr.RecordingStream(whole_text(f"{self.application}: {Path(path).stem}"))
                # Rerun's own writer, a thread per file, takes a fifth more time.
                kept = stream.memory_recording() if self.in_memory else stream.save(part)
                _lay_out(stream, layout)
                send(stream)
                if kept is None:
                    stream.flush()
                else:
                    part.write_bytes(kept.drain_as_bytes())
                stream.disconnect()
            return Path(path)

        return finish

    def send(self, name: str, address: str) -> None:
        """Send it to a viewer that listens.

        Args:
            name: Name of the recording.
            address: `host:port`, or rerun's own `rerun+http://host:port/proxy`.

        Raises:
            InvalidInputError: Nobody listens there.
        """
        stream = connected(f"{self.application}: {name}", address, self.layout())
        self.make()(stream)
        stream.flush()
        stream.disconnect()

    def widget(self, *, width: int | None = None, height: int | None = None) -> Any:
        """Rerun's viewer for a cell of a notebook, with this recording in it.

        Args:
            width: Pixels; None for all that the cell has.
            height: Pixels; None for rerun's own.

        Returns:
            A `rerun.notebook.Viewer`, which shows itself where it is a cell's last value.

        Raises:
            MissingPackageError: The package of the widget is not installed.
        """
        import rerun as rr

        if importlib.util.find_spec("rerun_notebook") is None:
            raise MissingPackageError("rerun-sdk[notebook]", "The viewer in a notebook")
        from rerun.notebook import Viewer

        stream = rr.RecordingStream(f"{self.application}: notebook")
        viewer = Viewer(width=width or "auto", height=height, recording=stream)
        _lay_out(stream, self.layout())
        self.make()(stream)
        stream.flush()
        return viewer


def connected(application: str, address: str, layout: Any) -> Any:
    """A `rerun.RecordingStream` into a viewer that listens.

    Args:
        application: That the recording names.
        address: `host:port`, or rerun's own `rerun+http://host:port/proxy`.
        layout: The `rerun.blueprint.Blueprint` that the viewer is to show it in.

    Raises:
        InvalidInputError: Nobody listens there.
    """
    import rerun as rr

    host, port = check_viewer(address)
    stream = rr.RecordingStream(whole_text(application))
    stream.connect_grpc(f"rerun+http://{host}:{port}/proxy")
    _lay_out(stream, layout)
    return stream


def _lay_out(stream: Any, layout: Any) -> None:
    """Let the viewer show a layout: where it is the default alone, browsers make one of their own instead."""
    stream.send_blueprint(layout, make_active=True, make_default=True)


def check_viewer(address: str) -> tuple[str, int]:
    """Host and port of a viewer that listens.

    Args:
        address: `host:port`, or rerun's own `rerun+http://host:port/proxy`.

    Raises:
        InvalidInputError: It is no address, or nobody listens there.
    """
    host, _, text = address.removeprefix("rerun+http://").removesuffix("/proxy").rpartition(":")
    if not host or not text.isdecimal() or not 0 < int(text) < 65536:
        raise InvalidInputError("connect", address, "Give host:port, such as 127.0.0.1:9876.")
    port = int(text)
    if not _listens(host, port):
        fix = f"Start a viewer there first, since none listens: rerun --bind {LOOPBACK} --port {port}."
        raise InvalidInputError("connect", address, fix)
    return host, port


def viewer_command(*arguments: str, bind: str = LOOPBACK) -> list[str]:
    """The command line that runs rerun's viewer, its servers bound to an address.

    The viewer's own program where it is found, not the script around it: that would outlive its parent's end.
    """
    import rerun_cli

    folder = Path(rerun_cli.__file__).parent
    bundled = folder / "Rerun.app" / "Contents" / "MacOS" / "Rerun"
    given = os.environ.get("RERUN_CLI_PATH")
    program = Path(given) if given else bundled if bundled.exists() else folder / "rerun"
    start = [str(program)] if program.exists() else [sys.executable, "-m", "rerun_cli"]
    return [*start, "--bind", bind, *arguments]


def free_port(bind: str = LOOPBACK) -> int:
    """A port of an address that nobody listens on.

    Raises:
        InvalidInputError: It is no address of this machine.
    """
    try:
        with socket.socket(socket.AF_INET6 if ":" in bind else socket.AF_INET) as probe:
            probe.bind((bind, 0))
            return int(probe.getsockname()[1])
    except OSError as error:
        raise InvalidInputError("bind", bind, f"Give an address of this machine ({error.strerror}).") from error


def reachable(bind: str) -> str:
    """How an address that servers listen on is written into a browser's; of all addresses this machine's own."""
    if bind in _ALL:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.connect(_ANYWHERE)  # nothing is sent: the system only chooses the way
                return str(probe.getsockname()[0])
            except OSError:  # there is no network
                return LOOPBACK
    return f"[{bind}]" if ":" in bind else bind


def has_display() -> bool:
    """Whether a window can be opened here, as far as the environment says."""
    if not sys.platform.startswith("linux"):
        return True
    return any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"))


def start_viewer(bind: str = LOOPBACK) -> str:
    """Start a viewer that outlives this process, and wait until it listens.

    Returns:
        Its address, `host:port`.

    Raises:
        InvalidInputError: It does not start.
    """
    port = free_port(bind)
    viewer = subprocess.Popen(  # noqa: S603 - our own command line
        viewer_command("--port", str(port), "--expect-data-soon", bind=bind),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    until = time.monotonic() + _PATIENCE
    listened = False
    while time.monotonic() < until and viewer.poll() is None:
        if listened:  # and still runs: without a display it listens first and ends then
            return f"{bind}:{port}"
        listened = _listens(bind, port)
        time.sleep(_SETTLING if listened else 0.1)
    if viewer.poll() is None:
        viewer.terminate()
    fix = "Write a file (`save`, --save FILE.rrd), and open the file where there is a display."
    raise InvalidInputError("spawn", "the viewer does not start here", fix)


def _listens(host: str, port: int) -> bool:
    try:
        with socket.create_connection((host, port), timeout=2.0):
            return True
    except OSError:
        return False


_AT_ONCE = 2  # encoding one takes longer than making the next


def check_delivery(save: Path | None, connect: str | None) -> None:
    """Refuse before the work what could not be delivered after it.

    Raises:
        InvalidInputError: The file cannot be written or is not to be named `.rrd`, or no viewer listens.
    """
    check_output(save)
    if save is not None and save.suffix != ".rrd":
        raise InvalidInputError("save", str(save), "Let the name end in .rrd.")
    if connect is not None:
        check_viewer(connect)


def deliver(
    recordings: Sequence[tuple[str, Recording]], save: Path | None, connect: str | None, *, spawn: bool, several: bool
) -> list[Path]:
    """Write and send recordings.

    Args:
        recordings: Id and recording of each.
        save: File to write; where there are several, each goes to a file with its id in the name.
        connect: Address of a viewer that listens.
        spawn: Start a viewer and send them there.
        several: Whether the run was about several, even if only one is left.

    Returns:
        The files written.

    Raises:
        InvalidInputError: A file cannot be written, or there is no viewer.
    """
    written = [] if save is None else _write(recordings, save, several=several)
    addresses = [address for address in (connect, start_viewer() if spawn and recordings else None) if address]
    for address in addresses:
        for identity, recording in recordings:
            recording.send(identity, address)
    return written


def _write(recordings: Sequence[tuple[str, Recording]], save: Path, *, several: bool) -> list[Path]:
    """Write recordings to files: while some are encoded and written, the next is made."""
    written: list[Path] = []
    taken: set[str] = set()
    with ThreadPoolExecutor(max_workers=_AT_ONCE) as background:
        before: list[Future[Path]] = []
        for identity, recording in recordings:
            suffix = re.sub(r"[^\w.-]+", "-", identity)
            name = distinct(f"{save.stem}-{suffix}" if several else save.stem, taken)  # names need not be unique
            target = save.with_name(f"{name}{save.suffix}")
            before.append(background.submit(recording.begin(target)))
            if len(before) > _AT_ONCE:  # no more of them in memory
                written.append(before.pop(0).result())
        return written + [future.result() for future in before]
