"""Decoders of other programs in a process of their own, on files of unknown origin that may kill it.

Some decoders (SciPy's for MATLAB files, rerun's for recordings, those of ONNX) do not raise on damaged content but end
the process. A child process that dies is an error like any other. It is started when it is first asked, which takes
about a second, and serves until it is closed. Its memory is limited where the system can do that (Linux).

The child is an interpreter of its own that gets pickles through a pipe, and none of `multiprocessing`'s processes:
those run the caller's script once more, which then needs a main guard. Whoever reads a file must not need one.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import traceback
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures import TimeoutError as LateError
from contextlib import suppress
from io import BytesIO
from multiprocessing.spawn import get_executable
from typing import IO, Any, ParamSpec, Self, TypeVar

from fgrecon.core.errors import ChildNotBegunError, InvalidInputError
from fgrecon.io.arrays import LARGEST, largest_bytes

P = ParamSpec("P")
T = TypeVar("T")

_ROOM = 8  # times what a file may unpack to: for the decoder itself, its threads and copies
_FIX = f"Give an undamaged file; for a large one raise the environment variable {LARGEST}, in bytes."
_CHILD = """\
import pickle, sys
sys.path[:], memory = pickle.load(sys.stdin.buffer)
from fgrecon.io.isolated import serve
serve(memory)
"""


class Isolated:
    """A child process for one piece of work after the other; a context manager."""

    def __init__(self, seconds: float = 120.0, late: str = "Give an undamaged file.") -> None:
        """Prepare it.

        Args:
            seconds: After which a piece of work is given up, the start of the process included.
            late: What to do about work that took longer.
        """
        self._seconds, self._late = seconds, late
        self._process: subprocess.Popen[bytes] | None = None
        self._begun = False

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the process."""
        self.close()

    def close(self) -> None:
        """End the process, whatever it is doing."""
        process, self._process = self._process, None
        if process is None:
            return
        process.kill()
        process.wait()
        self._thread.shutdown()
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                with suppress(OSError):  # what was still to be sent to it
                    pipe.close()

    def __call__(self, source: str, work: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """The result of a function of a module, called in the child; what it raises is raised here.

        Args:
            source: What is read, for the error.
            args: Its arguments, which can be pickled, and so can be what it returns.

        Raises:
            InvalidInputError: The child died of it, took too long, or took too much memory.
            ChildNotBegunError: The child died before it began with it, or could not be started at all.
        """
        if getattr(sys, "frozen", False):  # there is no interpreter to start: its executable is the whole program
            return work(*args, **kwargs)
        job = pickle.dumps((work, args, kwargs))
        try:
            process = self._process or self._start()
            good, answer = _load(BytesIO(self._thread.submit(self._exchange, process, job).result(self._seconds)))
        except ChildNotBegunError:
            self.close()
            raise
        except _DiedError as error:
            self.close()
            raise InvalidInputError(source, "damaged: it kills its decoder", _FIX) from error
        except LateError as error:
            self.close()
            raise InvalidInputError(source, f"nothing after {self._seconds:g} seconds", self._late) from error
        if isinstance(answer, MemoryError) and not good:
            raise InvalidInputError(source, "more than fits into memory", _FIX) from answer
        if not good:
            raise answer
        return answer

    def _start(self) -> subprocess.Popen[bytes]:
        """The process, and a thread that speaks with it, so that an answer is waited for no longer than is allowed."""
        command = [os.fsdecode(get_executable()), "-P", "-c", _CHILD]
        try:
            pipe = subprocess.PIPE
            process = self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe)  # noqa: S603  # this interpreter
        except OSError as error:
            raise ChildNotBegunError(f"{command[0]}: {error}") from error
        self._begun, self._thread = False, ThreadPoolExecutor(1)
        return process

    def _exchange(self, process: subprocess.Popen[bytes], job: bytes) -> bytes:
        jobs, answers = process.stdin, process.stdout
        assert jobs is not None
        assert answers is not None
        try:
            if not self._begun:
                _send(jobs, (sys.path, _ROOM * largest_bytes()))
                self._begun = bool(_load(answers))
            _send(jobs, job)
            answer: bytes = _load(answers)
        except (EOFError, OSError, pickle.UnpicklingError) as error:  # the pipe's other end died, maybe half-way
            if self._begun:
                raise _DiedError from error
            raise ChildNotBegunError(f"it ended with exit code {process.wait()}") from error
        return answer


class _DiedError(Exception):
    """The child died of its work."""


def serve(memory: int) -> None:
    """What the child runs: answer one work after the other, in so many bytes, until the parent closes the pipe."""
    _limit(memory)
    jobs, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 1)  # answers go there: whoever prints must not be taken for one
    _send(answers, "begun")
    os.dup2(silence, 2)  # decoders print pages when they die; the parent reports it
    with suppress(EOFError):
        while True:
            _send(answers, _answer(_load(jobs)))


def _limit(memory: int) -> None:
    if sys.platform == "linux":
        import resource

        _, most = resource.getrlimit(resource.RLIMIT_DATA)
        limit = memory if most == resource.RLIM_INFINITY else min(memory, most)
        resource.setrlimit(resource.RLIMIT_DATA, (limit, most))


def _answer(job: bytes) -> bytes:
    """Whether a piece of work went well, and what it returned or raised, pickled."""
    try:
        work, args, kwargs = _load(BytesIO(job))
        return pickle.dumps((True, work(*args, **kwargs)))
    except Exception as error:  # noqa: BLE001  # raised by the parent
        error.add_note(traceback.format_exc())
        try:
            answer = pickle.dumps((False, error))
            _load(BytesIO(answer))
        except Exception:  # noqa: BLE001  # some errors do not survive that
            return pickle.dumps((False, RuntimeError(f"{type(error).__name__}: {error}")))
        return answer


def _send(pipe: IO[bytes], content: Any) -> None:
    pickle.dump(content, pipe)
    pipe.flush()


def _load(pipe: IO[bytes]) -> Any:
    return pickle.load(pipe)  # noqa: S301  # both ends are ours
