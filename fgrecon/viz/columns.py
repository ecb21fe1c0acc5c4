"""Chunks on their way into a recording: columns of rows, fields that are made once, and histories to the last bit."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array

FIELDS = "fields"
"""Name of the component that `exact_column` makes."""


@dataclass(frozen=True)
class Outbox:
    """Chunks on their way into a stream, to which they go all at once: sent one by one, each wakes rerun's threads."""

    name: str  # name of the recording
    chunks: list[Any] = field(default_factory=list)  # what was sent so far
    # where an entity goes: what is sent for one of several vehicles has a branch of its own
    place: Callable[[str], str] = str

    def branch(self, place: Callable[[str], str]) -> Outbox:
        """The same outbox for senders whose entities are to go elsewhere."""
        return replace(self, place=place)

    def send_columns(self, entity: str, times: Iterable[Any], columns: Iterable[Any]) -> None:
        """Add time and component columns; without times what holds always."""
        from rerun.chunk import Chunk

        self.chunks.append(Chunk.from_columns(self.place(entity), times, columns))

    def send_fixed(self, entity: str, archetype: Any, **fields: Any) -> None:
        """Add fields of an archetype without a time, such as its style; their values must be hashable."""
        self.chunks.append(_fixed(self.place(entity), archetype, tuple(fields.items())))

    def empty_into(self, stream: Any) -> None:
        """Send all of them and the name into a `rerun.RecordingStream`."""
        stream.send_recording_name(self.name)
        stream.send_chunks(self.chunks)


@lru_cache(maxsize=512)
def _fixed(entity: str, archetype: Any, fields: tuple[tuple[str, Any], ...]) -> Any:
    """A chunk without a time, made once for the same values."""
    from rerun.chunk import Chunk

    return Chunk.from_columns(entity, [], fixed_columns(archetype, **dict(fields)))


def fixed_columns(archetype: Any, **fields: Any) -> tuple[Any, ...]:
    """Columns of what stays the same, to send with others of the entity: a chunk costs more than what is in it.

    Args:
        archetype: Class of rerun, such as `rr.Points3D`.
        fields: Values of its fields, which must be hashable: they are made once.
    """
    return _fixed_columns(archetype, tuple(fields.items()))


@lru_cache(maxsize=512)
def _fixed_columns(archetype: Any, fields: tuple[tuple[str, Any], ...]) -> tuple[Any, ...]:
    return made_columns(archetype.from_fields(**dict(fields)))


def made_columns(archetype: Any) -> tuple[Any, ...]:
    """The columns of an archetype of rerun, in one row."""
    return tuple(batch.partition([len(batch.as_arrow_array())]) for batch in archetype.as_component_batches())


def strip_columns(archetype: Any, strips: Array) -> Any:
    """Strips (n, S, P, D) of `LineStrips2D` or `LineStrips3D` as n rows; those that are not finite are left out."""
    drawn = np.isfinite(strips).all(axis=(2, 3))
    return archetype.columns(strips=strips[drawn]).partition(drawn.sum(axis=1))


def exact_column(archetype: str, fields: Mapping[str, Sequence[Any] | NDArray[Any]]) -> Any:
    """One component of an archetype of our own, whose row i holds all elements of every field's values[i].

    One, not one for each field: the table of contents of a file has many columns for every component.

    Args:
        archetype: Its name.
        fields: Numbers, texts, or arrays or lists of them, one for each row; an array's first axis are the rows.
    """
    import pyarrow as pa
    import rerun as rr

    arrays = [
        pa.ListArray.from_arrays(np.arange(len(values) + 1, dtype=np.int32) * values[0].size, values.ravel())
        if isinstance(values, np.ndarray) and values.ndim > 1
        else pa.array(values)
        for values in fields.values()
    ]
    descriptor = rr.ComponentDescriptor(f"{archetype}:{FIELDS}", archetype=archetype)
    return rr.AnyBatchValue.column(descriptor, pa.StructArray.from_arrays(arrays, names=list(fields)))
