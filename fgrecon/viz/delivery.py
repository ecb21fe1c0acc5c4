"""Where recordings go: files, a viewer that listens, a viewer of their own."""

from __future__ import annotations

import re
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

from fgrecon.core.camera import Ground
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.text import distinct
from fgrecon.io.files import check_output
from fgrecon.viz.sinks import Recording, check_viewer, start_viewer
from fgrecon.viz.subjects import Photograph, SolvedVehicle

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


def recordings_of(sights: Sequence[SolvedVehicle], ground: Ground | None) -> list[tuple[str, Recording]]:
    """Title and recording of vehicles.

    Args:
        ground: The ground plane that was assumed.
    """
    from fgrecon.viz.recording import recording_of  # on use: it imports rerun

    images = {id(s.image): Photograph.of(s.image) for s in sights}  # several vehicles may be in one
    return [(s.title, recording_of(replace(s, image=images[id(s.image)]), ground=ground)) for s in sights]


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
