"""What several commands share: options, parsing of their values, outputs, the console."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:  # the command line must start fast: what the commands need is imported when they run
    from rich.console import Console

    from fgrecon.camera import Ground

__all__ = [
    "CameraHeightOption",
    "GroundOption",
    "JsonOption",
    "PriorOption",
    "check_output",
    "console",
    "ground_plane",
    "parse_numbers",
]

_WIDTH = 180

PriorOption = Annotated[str, typer.Option(help="Shape prior: a shipped name or an npz file.")]
CameraHeightOption = Annotated[
    float | None, typer.Option(help="Height of a level camera above the ground, m.", show_default="no ground plane")
]
GroundOption = Annotated[
    str | None,
    typer.Option(metavar="NX,NY,NZ,D", help="Ground plane instead: normal pointing down, camera height in m."),
]
JsonOption = Annotated[
    str | None, typer.Option("--json", metavar="FILE", help="Write the results as JSON; - for the output.")
]


def ground_plane(plane: str | None, height: float | None) -> tuple[Ground, str] | None:
    """The ground plane and, in words, where it comes from; None where neither option is given.

    Args:
        plane: `nx,ny,nz,d`.
        height: Height of a level camera, metres.

    Raises:
        InvalidInputError: Both are given, or one is not a plane.
    """
    from fgrecon.camera import Ground
    from fgrecon.errors import InvalidInputError

    if plane is not None and height is not None:
        raise InvalidInputError("camera_height", height, "Give either --camera-height or --ground.")
    if height is not None:
        return Ground.level(height), f"level camera {height:g} m above the ground"
    if plane is None:
        return None
    nx, ny, nz, distance = parse_numbers("ground", plane, "nx,ny,nz,d: four numbers", (4,))
    import numpy as np

    return Ground(np.array([nx, ny, nz]), distance), f"plane {plane}"


def parse_numbers(field: str, text: str, wanted: str, counts: tuple[int, ...]) -> list[float]:
    """Numbers separated by commas.

    Args:
        field: Name of the option, for errors.
        text: What was given.
        wanted: What to give, for errors.
        counts: How many there may be.

    Raises:
        InvalidInputError: Something is not a number, or there are too many or too few.
    """
    from fgrecon.errors import InvalidInputError

    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in counts:
        raise InvalidInputError(field, text, f"Give {wanted}.")
    return numbers


def check_output(path: Path | None) -> None:
    """Refuse an output that cannot be written before the work instead of after it.

    Raises:
        InvalidInputError: It is a folder, or its folder does not exist.
    """
    from fgrecon.errors import InvalidInputError

    if path is not None and (path.is_dir() or not path.resolve().parent.is_dir()):
        raise InvalidInputError("output", str(path), "Give a file in a folder that exists.")


def console(*, error: bool) -> Console:
    """A console for tables: the output, or the error stream where the output carries data."""
    from rich.console import Console

    made = Console(stderr=error, highlight=False, soft_wrap=True)
    if not made.is_terminal:
        made.width = _WIDTH  # a pipe has no width, and 80 columns would cut the numbers off
    return made
