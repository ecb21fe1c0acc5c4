"""The data of recordings in the form that costs least: columns made by hand, and chunks that are made once.

rerun's own constructors take many times as long as the numbers that they wrap; here they only tell the types.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "FIELDS",
    "Column",
    "Outbox",
    "column",
    "exact_column",
    "fixed_columns",
    "made_columns",
    "strip_column",
]

FIELDS = "fields"
"""Name of the component that `exact_column` makes."""


@dataclass(frozen=True)
class Column:
    """Arrow data that rerun takes as a component column."""

    descriptor: Any
    array: Any

    def component_descriptor(self) -> Any:
        """Name and type of the component."""
        return self.descriptor

    def as_arrow_array(self) -> Any:
        """One list per row."""
        return self.array


@dataclass(frozen=True)
class Outbox:
    """Chunks on their way into a stream, to which they go all at once: sent one by one, each wakes rerun's threads.

    Attributes:
        name: Name of the recording.
        chunks: What was sent so far.
        place: Where an entity goes: what is sent for one of several vehicles has a branch of its own.
    """

    name: str
    chunks: list[Any] = field(default_factory=list)
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


def exact_column(archetype: str, fields: Mapping[str, Sequence[Any] | NDArray[Any]]) -> Column:
    """One component of an archetype of our own, whose row i holds all elements of every field's values[i].

    One, not one for each field: the table of contents of a file has many columns for every component.

    Args:
        archetype: Its name.
        fields: Numbers, texts, or arrays or lists of them, one for each row; an array's first axis are the rows.
    """
    import pyarrow as pa
    import rerun as rr

    arrays = [
        pa.ListArray.from_arrays(_even_ends(len(values), prod(values.shape[1:])), pa.array(values.ravel()))
        if isinstance(values, np.ndarray) and values.ndim > 1
        else pa.array(values)
        for values in fields.values()
    ]
    rows = pa.StructArray.from_arrays(arrays, names=list(fields))
    descriptor = rr.ComponentDescriptor(f"{archetype}:{FIELDS}", archetype=archetype)
    return Column(descriptor, pa.ListArray.from_arrays(_even_ends(len(rows), 1), rows))


def column(
    archetype: Any, name: str, values: NDArray[Any] | Sequence[Any], counts: int | NDArray[np.int64] | None = None
) -> Column:
    """One field of an archetype in several rows.

    Args:
        archetype: Class of rerun, such as `rr.Points3D`.
        name: Its field, such as `positions`.
        values: N values, row after row: numbers (N,), vectors (N, D), rotations (N, 3, 3), RGB bytes (N, 3), or texts.
        counts: How many values each row has, or one number where all have as many; without it all are one row.
    """
    import pyarrow as pa

    descriptor, rows = _types(archetype, name, values.shape[1:] if isinstance(values, np.ndarray) else None)
    item = rows.value_type
    if not isinstance(values, np.ndarray):
        flat = pa.array(values, item)
    elif pa.types.is_fixed_size_list(item):
        in_order = values.swapaxes(1, 2) if values.ndim == 3 else values  # rerun's matrices are column by column
        numbers = pa.array(in_order.astype(item.value_type.to_pandas_dtype()).ravel())
        flat = pa.FixedSizeListArray.from_arrays(numbers, type=item)
    else:
        numbers = _packed(values) if values.ndim == 2 else values
        flat = pa.array(numbers.astype(item.to_pandas_dtype(), copy=False))
    if counts is None:
        ends = _even_ends(1, len(values))
    elif isinstance(counts, int):
        ends = _even_ends(len(values) // counts, counts)
    else:
        ends = _ends(counts)
    return Column(descriptor, pa.ListArray.from_arrays(ends, flat, type=rows))


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


def strip_column(archetype: Any, strips: NDArray[np.float64]) -> Column:
    """The strips (n, S, P, D) of `LineStrips2D` or `LineStrips3D` as n rows; those that are not finite are left out."""
    import pyarrow as pa

    descriptor, rows = _types(archetype, "strips", (2, strips.shape[3]))
    strip = rows.value_type
    finite = np.isfinite(strips)
    if finite.all():
        ends = _even_ends(*strips.shape[:2])
    else:
        drawn = finite.all(axis=(2, 3))
        strips, ends = strips[drawn], _ends(drawn.sum(axis=1))
    numbers = pa.array(strips.astype(np.float32).ravel())
    points = pa.FixedSizeListArray.from_arrays(numbers, type=strip.value_type)
    length = strips.shape[-2]
    lists = pa.ListArray.from_arrays(_even_ends(len(points) // length, length), points, type=strip)
    return Column(descriptor, pa.ListArray.from_arrays(ends, lists, type=rows))


def _ends(counts: NDArray[np.int64]) -> NDArray[np.int32]:
    """(n + 1,) where each of n rows begins, and where the last one ends."""
    ends = np.zeros(len(counts) + 1, dtype=np.int32)
    counts.cumsum(out=ends[1:])
    return ends


@lru_cache(maxsize=64)
def _even_ends(rows: int, count: int) -> Any:
    """The same as Arrow data where all rows have as many."""
    import pyarrow as pa

    return pa.array(np.arange(rows + 1, dtype=np.int32) * np.int32(count))


def _packed(colours: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """(N,) opaque colours as rerun packs them, of RGB bytes (N, 3)."""
    red, green, blue = colours.T.astype(np.uint32)
    packed: NDArray[np.uint32] = (red << 24) | (green << 16) | (blue << 8) | np.uint32(255)
    return packed


@lru_cache(maxsize=64)
def _types(archetype: Any, name: str, shape: tuple[int, ...] | None) -> tuple[Any, Any]:
    """Descriptor and Arrow type of a field, as rerun itself makes them of one value of a shape, or of a text."""
    (made,) = archetype.columns(**{name: ["text"] if shape is None else np.zeros((1, *shape))})
    return made.component_descriptor(), made.as_arrow_array().type
