"""`fgrecon serve`: the service for programs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated

import typer

from fgrecon.cli.commands import option
from fgrecon.cli.terminal import Quiet

if TYPE_CHECKING:  # the command line must start fast: what the commands need is imported when they run
    from fgrecon.app.serving import Server


@dataclass(frozen=True)
class ServerOptions:
    """Where a server listens, and how much it does at once."""

    host: str = option(
        "Address to listen at; the default is this machine alone.", default="127.0.0.1", metavar="ADDRESS"
    )
    workers: int | None = option("Processes that solve, of one thread each.", min=1, show_default="one a core")
    waiting: int = option("Requests that may wait; more are refused (503).", default=64, min=0)
    max_megabytes: int = option("Size of an uploaded image or keypoint file.", default=32, min=1)
    seconds: float = option("After which work on a request is given up.", default=60.0, min=1.0)

    def server(self, port: int) -> Server:
        """The same as the library takes it."""
        from fgrecon.app.limits import LIMITS
        from fgrecon.app.serving import Server

        limits = replace(
            LIMITS, upload_bytes=self.max_megabytes << 20, solve_seconds=self.seconds, waiting=self.waiting
        )
        return Server(self.host, port, self.workers, limits)


def serve_command(
    terminal: Quiet,
    options: ServerOptions,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port to listen at; 0 takes a free one.")] = 8000,
) -> None:
    """Answer programs over HTTP: POST an image or keypoints to /reconstruct, and get a results file (extra `serve`).

    The page / has all parameters, /openapi.json the same for programs, /health whether it works. Models are loaded
    once, by each worker. Listen at another address than this machine's own only in a network that you trust: no
    password is requested.
    """
    from fgrecon.core.errors import MissingPackageError

    try:
        from fgrecon.app.service import service
    except ImportError as error:
        raise MissingPackageError("fgrecon[serve]", "`fgrecon serve`") from error

    screen, server = terminal.screen(), options.server(port)
    server.run(
        lambda ready: service(server.count, server.limits, server.names, ready),
        lambda address: screen.print(f"Serving at {address} until Ctrl-C."),
    )
