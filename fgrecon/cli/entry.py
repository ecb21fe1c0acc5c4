"""The first that runs of the command line: Ctrl-C ends it without a traceback from here on."""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType

_INTERRUPTED = 130


def main() -> None:
    """Import the command line and run it; interrupted, exit with code 130."""
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
