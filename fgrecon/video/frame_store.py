"""Frames of a run, kept in a file: of a long video, memory holds a line for each frame.

The file has no name and is gone with the run, whatever ends it.
"""

from __future__ import annotations

import io
import pickle
import sys
import tempfile
import weakref
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import IO, Any, overload

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.history import LazyFields
from fgrecon.core.result_fields import Status
from fgrecon.core.shape_prior import ShapePrior, Surface
from fgrecon.core.text import without_numbers
from fgrecon.core.vehicle_estimate import VehicleEstimate
from fgrecon.video.follow import TrackedFrame

_SHARED = (Camera, ShapePrior, Surface)
"""What results of a run have in common."""


@dataclass
class FrameHead:
    """What memory holds of a frame."""

    number: int  # of the frame, within its source
    time: float  # seconds
    name: str  # of the frame
    problem: str | None  # why it could not be read, or None
    place: NDArray[np.float64] | None  # (3,) of the camera in the world; None where it is not known
    identities: tuple[int, ...]  # the vehicles that were detected in it
    found: dict[int, Status] = field(default_factory=dict)  # how the estimate of each ended, by id
    reasons: dict[int, tuple[str, ...]] = field(default_factory=dict)  # and why so, without numbers


class FrameStore(Sequence[TrackedFrame]):
    """Frames in order; each is read from the file when it is looked at, and a change to it changes nothing here.

    Attributes:
        heads: What memory holds of each.
    """

    def __init__(self, frames: Iterable[TrackedFrame] = (), *, folder: Path | None = None) -> None:
        """Keep some frames.

        Args:
            folder: Where the file is, which has no name; None for where temporary files are.
        """
        self.heads: list[FrameHead] = []
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115  # closed with the store
        weakref.finalize(self, _close, self._file)
        self._places: list[tuple[int, dict[int, int]]] = []  # in the file: of a frame, and of its estimates by id
        self._at: dict[float, int] = {}  # frames with estimates, by their time
        self._shared: dict[int, Any] = {}
        self._last: TrackedFrame | None = None
        for frame in frames:
            self.append(frame)

    def append(self, frame: TrackedFrame) -> None:
        """Add a frame."""
        pose = frame.world_T_camera
        place = None if pose is None else pose[:3, 3].copy()
        head = FrameHead(frame.number, frame.time, frame.name, frame.problem, place, tuple(frame.boxes))
        self.heads.append(head)
        self._places.append((self._write(replace(frame, estimates={})), {}))
        for identity, estimate in frame.estimates.items():
            self._keep(len(self) - 1, identity, estimate)
        if frame.observations:
            self._at[frame.time] = len(self) - 1
        self._last = frame

    def put(self, identity: int, estimate: VehicleEstimate) -> None:
        """Let an estimate be that of its vehicle in the frame of its time, if that shows it."""
        index = self._at.get(estimate.time)
        if index is not None and identity in self.heads[index].identities:
            self._keep(index, identity, estimate)
            self._last = None if index == len(self) - 1 else self._last

    def _keep(self, index: int, identity: int, estimate: VehicleEstimate) -> None:
        self._places[index][1][identity] = self._write(estimate)
        result, head = estimate.reconstruction, self.heads[index]
        head.found[identity] = result.status
        why = result.reasons or (() if result.status is Status.CONVERGED else (result.message,))
        head.reasons[identity] = tuple(sys.intern(without_numbers(reason)) for reason in why)

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.heads)

    @overload
    def __getitem__(self, index: int) -> TrackedFrame: ...

    @overload
    def __getitem__(self, index: slice) -> list[TrackedFrame]: ...

    def __getitem__(self, index: int | slice) -> TrackedFrame | list[TrackedFrame]:
        """A frame, or a list of some."""
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        if self._last is not None and index in (-1, len(self) - 1):
            return self._last
        place, estimates = self._places[index]
        frame: TrackedFrame = self._read(place)
        return replace(frame, estimates={identity: self._read(place) for identity, place in estimates.items()})

    def __iter__(self) -> Iterator[TrackedFrame]:
        """Over the frames."""
        return (self[i] for i in range(len(self)))

    def _write(self, value: Any) -> int:
        """Where it is in the file."""
        content = io.BytesIO()
        _Pickler(content, self._shared).dump(value)
        place = self._file.seek(0, io.SEEK_END)
        try:
            self._file.write(content.getbuffer())
            self._file.flush()
        except OSError as error:
            raise InvalidInputError("out", error.strerror, "Make room, or give another folder.") from error
        return place

    def _read(self, place: int) -> Any:
        self._file.seek(place)
        return _Unpickler(self._file, self._shared).load()


class _Pickler(pickle.Pickler):
    """Pickles results without what they share, and without what is made from it when it is looked at."""

    def __init__(self, file: io.BytesIO, shared: dict[int, Any]) -> None:
        super().__init__(file, pickle.HIGHEST_PROTOCOL)
        self._shared = shared

    def reducer_override(self, value: Any) -> Any:
        if isinstance(value, LazyFields):
            return object.__new__, (type(value),), vars(value)
        if not isinstance(value, _SHARED):
            return NotImplemented
        self._shared[id(value)] = value  # and so no other has that id
        return _shared, (id(value),)


def _shared(key: int) -> Any:
    """What results share, by its key; an `_Unpickler` has its own."""
    raise pickle.UnpicklingError(f"{key} is of a store of frames")


class _Unpickler(pickle.Unpickler):
    def __init__(self, file: Any, shared: dict[int, Any]) -> None:
        super().__init__(file)
        self._shared = shared

    def find_class(self, module: str, name: str) -> Any:
        return self._shared.__getitem__ if name == _shared.__name__ else super().find_class(module, name)


def _close(file: IO[bytes]) -> None:
    """Close a file without a name: what a full disk did not take is of no use any more."""
    with suppress(OSError):
        file.close()
