"""A service's pool of worker processes, one job each at a time, and the bounded queue before them."""

from __future__ import annotations

import asyncio
import tempfile
from collections.abc import Awaitable, Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from fgrecon.app.limits import Limits
from fgrecon.core.errors import FgreconError
from fgrecon.io.isolated import Isolated

T = TypeVar("T")
_TOO_LONG = "Give fewer vehicles, or a smaller image, or start the server with more --seconds."


class BusyError(FgreconError, RuntimeError):
    """More waits than may; the sender may try again later."""


class Workers:
    """Processes of one thread each, started when they are made ready; used from one event loop."""

    def __init__(self, count: int, limits: Limits, seconds: float) -> None:
        """Prepare them.

        Args:
            count: How many.
            limits: How many pieces may wait.
            seconds: After which work on a piece is given up.
        """
        self._limits, self._inside, self.count = limits, 0, count
        self._all = [Isolated(seconds, _TOO_LONG) for _ in range(count)]
        self._threads = ThreadPoolExecutor(count)
        self._free: asyncio.LifoQueue[Isolated] = asyncio.LifoQueue()
        for one in self._all:
            self._free.put_nowait(one)

    @property
    def waiting(self) -> int:
        """How many requests are inside that no worker is free for."""
        return max(self._inside - self.count, 0)

    async def make_ready(self, work: Callable[[], Any]) -> None:
        """Start all processes, and let each do something once."""
        loop = asyncio.get_running_loop()
        await asyncio.gather(*(loop.run_in_executor(self._threads, partial(one, "start", work)) for one in self._all))

    @contextmanager
    def place(self) -> Iterator[None]:
        """A place in the queue, to be taken before anything is read that needs memory.

        Raises:
            BusyError: There is none.
        """
        if self._inside >= self.count + self._limits.waiting:
            raise BusyError(f"{self._limits.waiting} requests wait already. Try again in a few seconds.")
        self._inside += 1
        try:
            yield
        finally:
            self._inside -= 1

    async def __call__(
        self,
        files: Mapping[str, bytes | Path],
        work: Callable[..., T],
        *args: Any,
        wanted: Callable[[], Awaitable[None]] | None = None,
    ) -> T:
        """What a function makes of some files, which are in a folder of their own as long as it works.

        Args:
            files: Content by name, plain names; or where a file is, which is linked.
            work: A function of a module; it is called with the folder.
            args: Its further arguments.
            wanted: What it raises when a worker is free ends the call: whoever asked may be gone by then.

        Raises:
            InvalidInputError: The process died of it, or took too long or too much memory.
            FgreconError: What the function raises.
        """
        worker = await self._free.get()
        try:
            if wanted is not None:
                await wanted()
        except BaseException:
            self._free.put_nowait(worker)
            raise
        done = asyncio.get_running_loop().run_in_executor(self._threads, _in_folder, worker, files, work, *args)
        done.add_done_callback(lambda _: self._free.put_nowait(worker))  # and not when whoever asked is gone
        return await asyncio.shield(done)

    def close(self) -> None:
        """End the processes, whatever they do."""
        for one in self._all:
            one.close()
        self._threads.shutdown(wait=False, cancel_futures=True)


def _in_folder(worker: Isolated, files: Mapping[str, bytes | Path], work: Callable[..., T], *args: Any) -> T:
    with tempfile.TemporaryDirectory(prefix="fgrecon-") as name:
        folder = Path(name)
        for file, content in files.items():
            if isinstance(content, bytes):
                (folder / file).write_bytes(content)
            else:
                (folder / file).symlink_to(content)
        return worker("request", work, folder, *args)
