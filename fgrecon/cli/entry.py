"""Entry of the command line that runs first: Ctrl-C ends it without a traceback from here on."""

from __future__ import annotations

import atexit
import os
import signal
import sys
import threading
from types import FrameType
from typing import NoReturn

_INTERRUPTED = 130


def run() -> NoReturn:
    """`main`, and the end of the process, which takes nothing apart that the system frees at once."""
    code = 0
    try:
        main()
    except SystemExit as ended:
        if ended.code and not isinstance(ended.code, int):
            raise
        code = int(ended.code or 0)
    # What Python does before it takes apart: wait for threads, and call what is registered.
    threading._shutdown()  # type: ignore[attr-defined]  # noqa: SLF001
    atexit._run_exitfuncs()  # noqa: SLF001
    try:
        for stream in filter(None, (sys.stdout, sys.stderr)):  # None where it was closed before
            stream.flush()
    except OSError:  # nobody reads on: Python says so in its way
        sys.exit(code)
    os._exit(code)


def main() -> None:
    """Import the command line and run it; interrupted, exit with code 130."""
    if "OMP_NUM_THREADS" not in os.environ:  # matrices are small, and threads that wait for large ones keep cores busy
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    interrupts: list[int] = []

    def interrupt(number: int, frame: FrameType | None) -> None:
        interrupts.append(number)
        signal.default_int_handler(number, frame)

    ours = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # else somebody ignores it, and we go on
    if ours:
        signal.signal(signal.SIGINT, _leave)
    from fgrecon.cli.main import main as command

    try:
        if ours:
            signal.signal(signal.SIGINT, interrupt)
        command()
    except KeyboardInterrupt:
        sys.exit(_INTERRUPTED)
    except Exception:  # compiled modules that are interrupted while they are imported raise an ImportError instead
        if interrupts:
            sys.exit(_INTERRUPTED)
        raise


def _leave(_number: int, _frame: FrameType | None) -> None:
    os._exit(_INTERRUPTED)  # nothing is open yet, and an exception in the middle of an import turns into others
