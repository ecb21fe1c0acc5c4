"""What several commands share: parsing of options' values, and outputs that are refused before the work."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # the command line must start fast: what the commands need is imported when they run
    from numpy.typing import NDArray
    from rich.table import Table

    from fgrecon.core.camera import Camera, Ground
    from fgrecon.io.boxes import NamedBox

__all__ = [
    "PartOfImage",
    "about_camera",
    "check_folder",
    "check_output",
    "check_outputs",
    "chosen_boxes",
    "ground_plane",
    "headed_table",
    "parse_crop",
    "parse_numbers",
]


def ground_plane(plane: str | None, height: float | None) -> tuple[Ground, str] | None:
    """The ground plane and, in words, where it comes from; None where neither option is given.

    Args:
        plane: `nx,ny,nz,d`, or `d` alone of a camera that may be tilted.
        height: Height of a level camera, metres.

    Raises:
        InvalidInputError: Both are given, one is not a plane, or the camera would be higher than 100 metres.
    """
    from fgrecon.core.camera import Ground
    from fgrecon.core.errors import InvalidInputError

    if plane is not None and height is not None:
        raise InvalidInputError("camera_height", height, "Give either --camera-height or --ground.")
    if height is not None:
        try:
            level = Ground.level(height)
        except InvalidInputError as error:
            raise InvalidInputError("camera_height", height, error.fix) from error
        return level, f"level camera {height:g} m above the ground"
    if plane is None:
        return None
    numbers = parse_numbers("ground", plane, "nx,ny,nz,d: four numbers, or d alone, the camera's height", (4, 1))
    if len(numbers) == 1:
        return Ground.of_height(numbers[0]), f"camera {numbers[0]:g} m above the ground, however tilted"
    import numpy as np

    nx, ny, nz, distance = numbers
    return Ground(np.array([nx, ny, nz]), distance).told(), f"plane {plane}"


@dataclass(frozen=True)
class PartOfImage:
    """A part of an image.

    Attributes:
        left: Columns before it.
        top: Rows above it.
        whole: (width, height) of the whole image in pixels, or None.
    """

    left: float
    top: float
    whole: tuple[int, int] | None


def parse_crop(text: str) -> PartOfImage:
    """What `--crop` says.

    Raises:
        InvalidInputError: It is not two or four numbers, or no part of an image.
    """
    from fgrecon.core.errors import InvalidInputError

    wanted = "left,top or left,top,width,height: the part's corner, and the size of the whole image, in pixels"
    left, top, *size = parse_numbers("crop", text, wanted, (2, 4))
    if min(left, top) < 0:
        raise InvalidInputError("crop", text, f"Give {wanted}.")
    if not all(side >= 1 and side == round(side) for side in size):
        raise InvalidInputError("crop", text, "Give width and height in whole pixels.")
    return PartOfImage(left, top, (int(size[0]), int(size[1])) if size else None)


def parse_numbers(field: str, text: str, wanted: str, counts: tuple[int, ...]) -> list[float]:
    """Numbers separated by commas.

    Args:
        field: Name of the option, for errors.
        text: What was given.
        wanted: What to give, for errors.
        counts: How many there may be.

    Raises:
        InvalidInputError: Something is not a finite number, or there are too many or too few.
    """
    from fgrecon.core.errors import InvalidInputError

    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in counts or not all(map(math.isfinite, numbers)):
        raise InvalidInputError(field, text, f"Give {wanted}.")
    return numbers


def chosen_boxes(
    path: Path,
    image: NDArray[Any],
    box: Sequence[str] | None,
    boxes: Path | None,
    *,
    detect: bool,
    least_score: float | None = None,
) -> list[NamedBox]:
    """The cars of an image by --box, --boxes or --detect.

    Args:
        path: The image's file.
        image: (H, W, 3) its pixels.
        box: Boxes as `x1,y1,x2,y2`.
        boxes: File of boxes, or None.
        detect: Whether the image is searched.
        least_score: Boxes of a lower score are left out; None for what suits their source.

    Raises:
        InvalidInputError: Not exactly one of these is given, a box is none, or there is no car.
    """
    from fgrecon.perception.boxes import boxes_of

    wanted = "x1,y1,x2,y2: four numbers in pixels"
    given = [parse_numbers("box", text, wanted, (4,)) for text in box or ()]
    search = image if detect else None
    return boxes_of(path, given, boxes, search, (image.shape[1], image.shape[0]), least_score)


def check_output(path: Path | None) -> None:
    """Refuse an output that cannot be written before the work instead of after it.

    Raises:
        InvalidInputError: It is a folder, its folder does not exist, or it is a link to itself.
    """
    from fgrecon.core.errors import InvalidInputError
    from fgrecon.io.files import behind_links

    if path is not None and (path.is_dir() or not behind_links(path).parent.is_dir()):
        raise InvalidInputError("output", str(path), "Give a file in a folder that exists.")


def check_folder(path: Path) -> None:
    """Refuse a folder of results that cannot be made, before the work.

    Raises:
        InvalidInputError: It is a file or would be in one, or is a link to itself.
    """
    from fgrecon.core.errors import InvalidInputError
    from fgrecon.io.files import behind_links

    there = next(part for part in (path, *behind_links(path).parents) if part.exists())
    if not there.is_dir():
        raise InvalidInputError("out", str(path), f"Give another folder: {there} is a file.")


def check_outputs(json_out: str | None, *paths: Path | None, picture: Path | None = None) -> None:
    """`check_output` for what `--json` names and for further files.

    Raises:
        InvalidInputError: One cannot be written, or the picture's name has the ending of none.
    """
    for path in (*paths, picture, None if json_out in (None, "-") else Path(str(json_out))):
        check_output(path)
    if picture is not None:
        from fgrecon.core.errors import InvalidInputError
        from fgrecon.viz.picture import FORMATS

        if picture.suffix.lower().removeprefix(".") not in FORMATS:
            raise InvalidInputError("picture", str(picture), f"Let the name end in one of {', '.join(FORMATS)}.")


def headed_table(*headings: str, left: int = 1, wrap: bool = False) -> Table:
    """A table without rows, of texts in its first columns and of numbers in the others.

    Args:
        headings: Of the columns.
        left: How many hold texts, which are on the left and never wrapped.
        wrap: Whether the others may be wrapped.
    """
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for number, heading in enumerate(headings):
        is_text = number < left
        table.add_column(heading, justify="left" if is_text else "right", no_wrap=is_text or not wrap)
    return table


def about_camera(camera: Camera, own: Camera | None, cars: str = "its cars") -> str:
    """How far to trust distances where no camera is given.

    Args:
        camera: The one that was found.
        own: The one that the photograph's file tells, or None.
        cars: Whose looks tell it, in words.
    """
    source = f"what {cars} look like" if own is None else f"the EXIF data and {cars}"
    return (
        f"No camera is given: the focal length is {camera.matrix[0, 0]:.0f} px, known to "
        f"{100 * camera.focal_sigma:.0f} %, from {source}. Distances are as rough. Give --camera or --intrinsics."
    )
