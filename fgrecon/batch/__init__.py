"""Vehicles by the thousand: a reconstructor of Arrow tables, and runs that write Parquet and can be killed.

`Reconstructor` turns a table of vehicles or images into a table of results; it can be pickled and loads prior and
networks once, so that it runs wherever tables are mapped: in Ray, Dask, Spark, Beam. `run` maps it over files by a
pool of processes, or by Ray, and writes the rows as they are done: what `fgrecon batch` does. `result_schema` says what
is in a row, and `reconstruction_of` makes a `Reconstruction` of one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from factors.lazy import lazy_names

if TYPE_CHECKING:  # imported when used
    from fgrecon.batch.inputs import InputFile, sources_of
    from fgrecon.batch.parts import read_folder
    from fgrecon.batch.reconstructor import Reconstructor
    from fgrecon.batch.rows import reconstruction_of
    from fgrecon.batch.runs import Tally, run
    from fgrecon.batch.schema import result_schema

__all__ = [
    "InputFile",
    "Reconstructor",
    "Tally",
    "read_folder",
    "reconstruction_of",
    "result_schema",
    "run",
    "sources_of",
]

__getattr__, __dir__ = lazy_names(__name__)
