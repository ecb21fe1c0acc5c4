"""What can kill its process runs in another one: decoders of other programs, on files of unknown origin.

Some decoders (SciPy's for MATLAB files, rerun's for recordings, those of ONNX) do not raise on damaged content but end
the process. A child process that dies is an error like any other. It is started when it is first asked, which takes
about a second, and serves until it is closed. Its memory is limited where the system can do that (Linux).
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures import TimeoutError as LateError
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from types import TracebackType
from typing import ParamSpec, Self, TypeVar

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.arrays import LARGEST, largest_bytes

__all__ = ["Isolated"]

P = ParamSpec("P")
T = TypeVar("T")

_ROOM = 8  # times what a file may unpack to: for the decoder itself, its threads and copies
_FIX = f"Give an undamaged file; for a large one raise the environment variable {LARGEST}, in bytes."


class Isolated:
    """A child process for one piece of work after the other; a context manager."""

    def __init__(self, seconds: float = 120.0) -> None:
        """Prepare it.

        Args:
            seconds: After which a piece of work is given up, the start of the process included.
        """
        self._seconds = seconds
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the process."""
        self.close()

    def close(self) -> None:
        """End the process, whatever it is doing."""
        pool, self._pool = self._pool, None
        if pool is None:
            return
        processes = list((pool._processes or {}).values())  # noqa: SLF001  # no public way to end what hangs
        pool.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            process.kill()
            process.join()

    def __call__(self, source: str, work: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """The result of a function of a module, called in the child; what it raises is raised here.

        Args:
            source: What is read, for the error.
            work: The function.
            args: Its arguments, which can be pickled, and so can be what it returns.
            kwargs: Likewise.

        Raises:
            InvalidInputError: The child died of it, took too long, or took too much memory.
        """
        if self._pool is None:
            self._pool = ProcessPoolExecutor(1, get_context("spawn"), _begin, (_ROOM * largest_bytes(),))
        future: Future[T] = self._pool.submit(work, *args, **kwargs)
        try:
            return future.result(self._seconds)
        except BrokenProcessPool as error:
            self.close()
            raise InvalidInputError(source, "damaged: it kills its decoder", _FIX) from error
        except MemoryError as error:
            raise InvalidInputError(source, "more than fits into memory", _FIX) from error
        except LateError as error:
            self.close()
            value = f"nothing after {self._seconds:g} seconds of decoding"
            raise InvalidInputError(source, value, "Give an undamaged file.") from error


def _begin(memory: int) -> None:
    """Limit the child's memory, and close its error stream: decoders print pages when they die; the parent tells."""
    if sys.platform == "linux":
        import resource

        _, most = resource.getrlimit(resource.RLIMIT_DATA)
        limit = memory if most == resource.RLIM_INFINITY else min(memory, most)
        resource.setrlimit(resource.RLIMIT_DATA, (limit, most))
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
