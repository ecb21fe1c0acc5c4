"""`fgrecon reconstruct`: pose and shape of every vehicle in a keypoint file, or in boxes of images."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fgrecon.cli.reconstruct_options import ReconstructRequest
from fgrecon.cli.terminal import Terminal


def reconstruct_command(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE...", help="Keypoints (of any known format), a track, or images and folders of them."
        ),
    ],
    request: ReconstructRequest,
    terminal: Terminal,
) -> None:
    """Reconstruct the pose and shape of the vehicles in a keypoint file or in images (--box, --boxes or --detect).

    A vehicle that is refused is reported, and the others go on. --verbose has all messages, energies and times.
    Several images, or a folder of them, need --out: each has a file of its own there, and one that cannot be used does
    not stop the others.

    Exit code 0: at least one was reconstructed, of several images in each; 1: none, since solving failed, or images
    without any; 2: none, since the input is bad, or no car was found in the image.

    Without a camera the focal length is the one in the photograph's EXIF data, or estimated from its cars together.
    """
    from fgrecon.cli.reconstruct_run import reconstruct_each, reconstruct_file

    request.check()
    screen = terminal.screen(request.results.json_out)
    if not (reconstruct_file if request.of_one(files) else reconstruct_each)(files, request, screen):
        raise typer.Exit(1)
