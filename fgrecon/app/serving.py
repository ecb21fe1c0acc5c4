"""Runs an ASGI application at an address until it is interrupted."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from fgrecon.app.limits import LIMITS, Limits
from fgrecon.core.errors import InvalidInputError, MissingPackageError
from fgrecon.core.processes import one_thread_each

_LOOPBACK = {"127.0.0.1": ("127.0.0.1", "localhost"), "localhost": ("127.0.0.1", "localhost")}
_BACKLOG = 256
_GRACE = 3  # seconds that requests have to end when the server is ended


@dataclass(frozen=True)
class Server:
    """Where a server listens, and how much it does at once."""

    host: str = "127.0.0.1"  # the address
    port: int = 8000  # the port; 0 takes a free one
    workers: int | None = None  # how many processes solve; None for one a core
    limits: Limits = LIMITS  # what it takes

    @property
    def names(self) -> tuple[str, ...]:
        """Names under which it may be asked for: at this machine's own address others are tricks of foreign pages."""
        return _LOOPBACK.get(self.host, ("*",))

    @property
    def count(self) -> int:
        """How many processes solve."""
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
        return self.workers or cores or 1

    def run(self, make: Callable[[Callable[[], None]], Any], ready: Callable[[str], None]) -> None:
        """Serve until it is interrupted.

        Args:
            make: Makes the ASGI application, which calls what it is given when it is ready.
            ready: Called with the address then.

        Raises:
            MissingPackageError: The extra is not installed.
            InvalidInputError: It cannot listen there.
        """
        try:
            import uvicorn
        except ImportError as error:
            raise MissingPackageError("fgrecon[serve]", "A server") from error

        with _listening(self.host, self.port) as listener, one_thread_each():
            name = f"[{self.host}]" if ":" in self.host else self.host
            address = f"http://{name}:{listener.getsockname()[1]}"
            config = uvicorn.Config(
                make(lambda: ready(address)),
                log_level="warning",
                access_log=False,
                server_header=False,
                proxy_headers=False,
                timeout_graceful_shutdown=_GRACE,
            )
            uvicorn.Server(config).run([listener])


def _listening(host: str, port: int) -> socket.socket:
    try:
        family, kind, protocol, _, place = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except OSError as error:
        raise InvalidInputError("host", host, "Give an address of this machine.") from error
    listener = socket.socket(family, kind, protocol)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind(place)
        listener.listen(_BACKLOG)  # who comes before it is ready waits
    except OSError as error:
        listener.close()
        fix = f"Give an address of this machine and a free port ({error.strerror})."
        raise InvalidInputError("host", f"{host}, port {port}", fix) from error
    return listener
