"""Tables of feather and Parquet files, whose columns are checked as they are taken."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.checks import as_quaternion
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import quaternion_pose


@dataclass(frozen=True)
class Columns:
    """A table."""

    table: Any  # the table (pyarrow's)
    where: str  # what errors begin with

    def __len__(self) -> int:
        """How many rows it has."""
        return int(self.table.num_rows)

    def values(self, name: str) -> list[Any]:
        """A column."""
        if name not in self.table.column_names:
            listed = ", ".join(self.table.column_names)
            raise InvalidInputError(f"{self.where}{name}", "no such column", f"Give this column; there are {listed}.")
        column = self.table.column(name)
        if column.null_count:
            raise InvalidInputError(f"{self.where}{name}", f"{column.null_count} empty values", "Give all of them.")
        return column.to_pylist()

    def numbers(self, *names: str) -> Array:
        """(N, len(names)) of columns."""
        rows = []
        for name in names:
            found = self.values(name)
            try:
                values = np.array(found, dtype=np.float64)
                if values.ndim != 1 or bool in map(type, found):
                    raise TypeError(name)
            except (TypeError, ValueError):
                raise InvalidInputError(f"{self.where}{name}", "no numbers", "Give a column of numbers.") from None
            wrong = np.flatnonzero(~np.isfinite(values))
            if len(wrong):
                raise InvalidInputError(f"{self.where}{name}: row {wrong[0]}", values[wrong[0]], "Give finite numbers.")
            rows.append(values)
        return np.stack(rows, axis=1)

    def poses(self, quaternion: Sequence[str], place: Sequence[str]) -> Array:
        """(N, 4, 4) poses of columns w, x, y, z and x, y, z.

        Raises:
            InvalidInputError: A column is missing, or a quaternion is no rotation; names column and row.
        """
        turns, places = self.numbers(*quaternion), self.numbers(*place)
        where = f"{self.where}{quaternion[0]}: row "
        exact = (as_quaternion(f"{where}{row}", turn) for row, turn in enumerate(turns))
        return np.array([quaternion_pose(q, t) for q, t in zip(exact, places, strict=True)]).reshape(-1, 4, 4)


def read_columns(path: Path, columns: Sequence[str] | None = None) -> Columns:
    """All or some columns of a feather or Parquet file, by its ending."""
    import pyarrow as pa
    from pyarrow import feather, parquet

    try:
        if path.suffix == ".feather":
            table = feather.read_table(path, columns=columns, memory_map=False)
        else:
            table = parquet.read_table(path, columns=columns)
        table.validate(full=True)
    except (OSError, ValueError, pa.ArrowException) as error:
        raise InvalidInputError(str(path), str(error), "Give a feather or Parquet file that is whole.") from error
    return Columns(table, f"{path}: ")
