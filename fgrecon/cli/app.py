"""`fgrecon app`: the page for people."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fgrecon.cli.serve import ServerOptions
from fgrecon.cli.terminal import Quiet


def app_command(
    terminal: Quiet,
    options: ServerOptions,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port to listen at; 0 takes a free one.")] = 8080,
    show: Annotated[bool, typer.Option("--show/--no-show", help="Open it in the browser.")] = True,
    label: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Right the boxes and keypoints of these images; they are saved as COCO keypoints, labels.json in it.",
        ),
    ] = None,
    models: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER|FILE", help="Show the closest of these car models (obj, ply, glb, npz) as well."),
    ] = None,
) -> None:
    """Look at it in a browser: a photograph, a video or keypoints in, cars in 3D out, without code (extra `app`).

    The page loads nothing from elsewhere, and keeps nothing but the labels of --label. Listen at another address than
    this machine's own only in a network that you trust: no password is requested.
    """
    from fgrecon.core.errors import MissingPackageError

    try:
        from fgrecon.app.page_app import page_app
    except ImportError as error:
        raise MissingPackageError("fgrecon[app]", "`fgrecon app`") from error
    from fgrecon.app.label_folder import LabelFolder
    from fgrecon.io.catalogue import load_category
    from fgrecon.io.models import read_models

    screen, server = terminal.screen(), options.server(port)
    folder = None if label is None else LabelFolder(label)
    if models is not None:
        read_models(models, load_category("car14"))  # refuses what is none

    def say(address: str) -> None:
        screen.print(f"The page is at {address} until Ctrl-C.")
        if show:
            import webbrowser

            webbrowser.open(address)

    server.run(lambda ready: page_app(server.count, server.limits, server.names, ready, folder, models), say)
