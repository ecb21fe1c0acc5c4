"""What several commands share: options, parsing of their values, outputs, the console."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fgrecon.core.robust import StrategyName

if TYPE_CHECKING:  # the command line must start fast: what the commands need is imported when they run
    from numpy.typing import NDArray
    from rich.console import Console

    from fgrecon.core.camera import Ground
    from fgrecon.io.boxes import NamedBox

__all__ = [
    "BOX_MODEL_HELP",
    "BoxOption",
    "BoxesOption",
    "CalibOption",
    "CameraHeightOption",
    "DetectOption",
    "GroundOption",
    "IntrinsicsOption",
    "JsonOption",
    "PriorOption",
    "SizePriorOption",
    "StrategyOption",
    "WeightsOption",
    "check_output",
    "check_outputs",
    "chosen_boxes",
    "console",
    "ground_plane",
    "parse_numbers",
    "write_json",
]

_WIDTH = 180

BOX_MODEL_HELP = "What 2D boxes enclose: the outline or the 3D box; off: they are no evidence."

CalibOption = Annotated[Path | None, typer.Option(help="KITTI calibration file; its P2 is the camera.")]
IntrinsicsOption = Annotated[
    str | None, typer.Option(metavar="FX,FY,CX,CY", help="Camera in pixels.", show_default="from the file")
]
PriorOption = Annotated[str, typer.Option(help="Shape prior: a shipped name or an npz file.")]
CameraHeightOption = Annotated[
    float | None, typer.Option(help="Height of a level camera above the ground, m.", show_default="no ground plane")
]
GroundOption = Annotated[
    str | None,
    typer.Option(metavar="NX,NY,NZ,D", help="Ground plane instead: normal pointing down, camera height in m."),
]
BoxOption = Annotated[
    list[str] | None, typer.Option("--box", metavar="X1,Y1,X2,Y2", help="2D box of a car, pixels; repeat for more.")
]
BoxesOption = Annotated[
    Path | None, typer.Option("--boxes", help="File of boxes: KITTI labels or detections, or COCO JSON.")
]
DetectOption = Annotated[bool, typer.Option("--detect", help="Find the cars in the image with the shipped detector.")]
SizePriorOption = Annotated[
    str | None,
    typer.Option(
        metavar="FLEET",
        help="How large vehicles are: kitti, apollo79, or length,width,height[,their spreads] in m.",
        show_default="as in the shape prior",
    ),
]
WeightsOption = Annotated[Path | None, typer.Option(help="Network.", show_default="the one that fgrecon ships")]
StrategyOption = Annotated[StrategyName, typer.Option(help="Robust strategy.")]
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
    from fgrecon.core.camera import Ground
    from fgrecon.core.errors import InvalidInputError

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
    from fgrecon.core.errors import InvalidInputError

    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in counts:
        raise InvalidInputError(field, text, f"Give {wanted}.")
    return numbers


def chosen_boxes(
    path: Path, image: NDArray[Any], box: Sequence[str] | None, boxes: Path | None, *, detect: bool
) -> list[NamedBox]:
    """The cars of an image by --box, --boxes or --detect.

    Args:
        path: The image's file.
        image: (H, W, 3) its pixels.
        box: Boxes as `x1,y1,x2,y2`.
        boxes: File of boxes, or None.
        detect: Whether the image is searched.

    Raises:
        InvalidInputError: Not exactly one of these is given, a box is none, or there is no car.
    """
    from fgrecon.perception.boxes import boxes_of

    wanted = "x1,y1,x2,y2: four numbers in pixels"
    given = [parse_numbers("box", text, wanted, (4,)) for text in box or ()]
    return boxes_of(path, given, boxes, image if detect else None)


def check_output(path: Path | None) -> None:
    """Refuse an output that cannot be written before the work instead of after it.

    Raises:
        InvalidInputError: It is a folder, or its folder does not exist.
    """
    from fgrecon.core.errors import InvalidInputError

    if path is not None and (path.is_dir() or not path.resolve().parent.is_dir()):
        raise InvalidInputError("output", str(path), "Give a file in a folder that exists.")


def check_outputs(json_out: str | None, *paths: Path | None) -> None:
    """`check_output` for what `--json` names and for further files.

    Raises:
        InvalidInputError: One cannot be written.
    """
    for path in (*paths, None if json_out in (None, "-") else Path(str(json_out))):
        check_output(path)


def write_json(target: str | None, text: str) -> None:
    """Write the text of `--json` to its file, whole or not at all, or for `-` to the output; nothing without a target.

    Raises:
        InvalidInputError: The file cannot be written.
    """
    from fgrecon.io.files import write_text

    if target == "-":
        sys.stdout.write(text)
    elif target is not None:
        write_text(target, text)


def console(*, error: bool) -> Console:
    """A console for tables: the output, or the error stream where the output carries data."""
    from rich.console import Console

    made = Console(stderr=error, highlight=False, soft_wrap=True)
    if not made.is_terminal:
        made.width = _WIDTH  # a pipe has no width, and 80 columns would cut the numbers off
    return made
