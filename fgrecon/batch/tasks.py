"""What a worker of a run does: it gets tasks as plain rows and gives back a table of results."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import pyarrow as pa

from fgrecon.batch.schema import task_schema

__all__ = ["TaskSolver", "Tasks"]

Tasks = Sequence[Mapping[str, Any]]
"""Rows of `task_schema`: whoever hands them out makes no table of them, and needs no memory for that."""


class TaskSolver:
    """Solves tasks by a function of tables; pickled with it, sent to each worker once."""

    def __init__(self, function: Callable[[Any], Any]) -> None:
        """Take what is called with a table of tasks: a `Reconstructor`."""
        self._function, self._begun = function, False

    def __call__(self, tasks: Tasks) -> Any:
        """A table of their results."""
        if not self._begun:
            _leave_pandas()
            self._begun = True
        return self._function(pa.Table.from_pylist(list(tasks), schema=task_schema()))


class _NoPandas:
    """Finds every module but pandas."""

    def find_spec(self, name: str, *_: object) -> None:
        """Nothing; others look for what is asked for.

        Raises:
            ModuleNotFoundError: It is pandas.
        """
        if name == "pandas":
            raise ModuleNotFoundError(name, name=name)


def _leave_pandas() -> None:
    """Let pyarrow do without pandas, which it imports for its first array: 40 MB that no worker has a use for.

    pyarrow looks once; where it does not find it, it leaves it alone until somebody asks for a data frame.
    """
    if "pandas" not in sys.modules:
        finder = _NoPandas()
        sys.meta_path.insert(0, finder)
        try:
            pa.array([])
        finally:
            sys.meta_path.remove(finder)
