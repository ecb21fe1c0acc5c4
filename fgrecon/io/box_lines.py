"""KITTI's lines of objects as 3D boxes that can be replaced: everything else of a line stays as it was written.

A line is `type truncated occluded alpha x1 y1 x2 y2 h w l x y z rotation_y [score]` (object set), or the same after
`frame track` (tracking set).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.box3d import Box3D
from fgrecon.core.camera import Camera
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.metrics import wrap_angle
from fgrecon.io.files import read_text
from fgrecon.io.images import IMAGES
from fgrecon.io.kitti_files import LABEL_COLUMNS, parse_object

_TRACKED = 2  # columns in front of a tracking line's object
_FIX = "Give lines of KITTI's objects: type, 14 numbers and a score or none; of its tracking set after frame and track."


Item_co = TypeVar("Item_co", covariant=True)  # an object of a file with a 3D box


@dataclass(frozen=True)
class BoxLine:
    """A line of a file."""

    text: str  # as it is written; an empty line is none of an object
    number: int  # of the line in its file, from 1
    frame: int | None  # its frame, where it is a line of the tracking set
    kind: str  # type of the object; empty where it is none
    corners: Array  # (4,) 2D box in pixels; NaN where it is marked as missing
    score: float  # of a result; 1 of a label
    location: Array  # (3,) centre of the box's bottom face in the labels' frame, metres
    rotation_y: float  # radians
    size: Array  # (3,) length, width and height, metres

    @property
    def place(self) -> Mapping[str, str | int]:
        """The number of the line."""
        return {"line": self.number}

    def box(self, offset: Array) -> Box3D | None:
        """The 3D box in the camera's frame; None where the line has none, or none in front of the camera.

        Args:
            offset: (3,) where the labels' frame lies from the camera's: a labelled point is at X + offset.
        """
        try:
            return Box3D(self.location + offset, self.rotation_y, self.size)
        except InvalidInputError:
            return None

    def with_box(self, box: Box3D, offset: Array) -> str:
        """The line with another 3D box, which is in the camera's frame; the observation angle alpha follows it."""
        words = self.text.split()
        start = 0 if self.frame is None else _TRACKED
        size = self.size if box.size is None else box.size
        place = box.location - offset
        alpha = float(wrap_angle(box.rotation_y - np.arctan2(place[0], place[2])))
        words[start + 3] = f"{alpha:.4f}"
        numbers = *size[::-1], *place, float(wrap_angle(box.rotation_y))  # KITTI writes height, width, length
        words[start + 8 : start + 15] = [f"{number:.4f}" for number in numbers]
        return " ".join(words)


@dataclass(frozen=True)
class BoxedImage(Generic[Item_co]):
    """An image and its objects."""

    name: str  # of the image, without ending
    image: Path | None  # its file; None where there is none
    source: Path  # the file of the objects
    objects: tuple[Item_co, ...]  # they: lines that are of none included
    camera: Camera | None = None  # that took it, where its data set tells


def boxed_images(boxes: Path, images: Path) -> list[BoxedImage[BoxLine]]:
    """The images that a source of boxes speaks of, in order.

    Args:
        boxes: A file of object lines for one image, a folder with such a file for each image, of its name; or a file of
            tracking lines.
        images: The image, or the folder of images; those of tracking lines are named by their frames' numbers.

    Raises:
        InvalidInputError: Nothing is there, the two do not go together, or a line is malformed; names file and line.
    """
    if boxes.is_dir():
        files = sorted(path for path in boxes.glob("*.txt") if path.is_file())
        if not files:
            raise InvalidInputError("boxes", str(boxes), "Give a folder with a text file for each image.")
        by_name = images_of(images)
        return [BoxedImage(f.stem, by_name.get(f.stem), f, tuple(read_box_lines(f))) for f in files]
    lines = read_box_lines(boxes)
    frames = {line.frame for line in lines if line.kind}
    if not frames:
        raise InvalidInputError("boxes", str(boxes), "Give a file with a line for each object.")
    if frames == {None}:
        if not images.is_file():
            raise InvalidInputError("images", str(images), f"Give the image that the boxes of {boxes} are of.")
        return [BoxedImage(images.stem, images, boxes, tuple(lines))]
    if None in frames:
        raise InvalidInputError(
            "boxes", str(boxes), "Give lines of the object set, or of the tracking set, not of both."
        )
    numbered = {int(name): path for name, path in images_of(images).items() if name.isdecimal()}
    each: dict[int, list[BoxLine]] = defaultdict(list)
    for line in lines:
        if line.frame is not None:
            each[line.frame].append(line)
    return [BoxedImage(f"{n:06d}", numbered.get(n), boxes, tuple(own)) for n, own in sorted(each.items())]


def images_of(folder: Path) -> dict[str, Path]:
    """The images of a folder by their names without ending; or one alone."""
    if folder.is_file():
        return {folder.stem: folder}
    found = {p.stem: p for p in sorted(folder.glob("*")) if p.suffix.lower() in IMAGES}
    if not found:
        raise InvalidInputError("images", str(folder), "Give an image, or a folder with images.")
    return found


def read_box_lines(path: Path) -> list[BoxLine]:
    """The lines of a file, whatever they are of."""
    return [_line(text, number, path) for number, text in enumerate(read_text(path, "boxes").splitlines(), start=1)]


def text_of(lines: Sequence[BoxLine], changed: Mapping[int, str]) -> str:
    """The text of lines, with other ones in the place of some by their numbers."""
    return "".join(f"{changed.get(line.number, line.text)}\n" for line in sorted(lines, key=lambda one: one.number))


def _line(text: str, number: int, path: Path) -> BoxLine:
    nothing = np.full(3, np.nan)
    words = text.split()
    if not words:
        return BoxLine(text, number, None, "", np.full(4, np.nan), np.nan, nothing, np.nan, nothing)
    tracked = len(words) >= LABEL_COLUMNS + _TRACKED and words[0].isdecimal()
    rest = words[_TRACKED:] if tracked else words
    try:
        kind, numbers = parse_object(" ".join(rest), scored=len(rest) > LABEL_COLUMNS)
    except ValueError as error:
        raise InvalidInputError(f"{path}:{number}", text[:80], _FIX) from error
    corners = np.array(numbers[3:7])
    return BoxLine(
        text=text,
        number=number,
        frame=int(words[0]) if tracked else None,
        kind=kind,
        corners=corners if (corners[2:] - corners[:2] > 0.0).all() else np.full(4, np.nan),
        score=numbers[14] if len(numbers) >= LABEL_COLUMNS else 1.0,
        location=np.array(numbers[10:13]),
        rotation_y=numbers[13],
        size=np.array([numbers[9], numbers[8], numbers[7]]),
    )
