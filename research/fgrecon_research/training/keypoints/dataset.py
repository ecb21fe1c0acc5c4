"""Photographs, car masks and labels, prepared once in memory-mapped arrays.

Of M photographs the arrays have 2 M rows: row M + i is photograph i as it would look from further away, where one could
be made (`distant.py`).
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.io.arrays import read_arrays
from fgrecon.io.files import MADE_AGAIN, write_bytes
from fgrecon.io.images import read_image
from fgrecon_research.training.keypoints.deform import LabelledView
from fgrecon_research.training.keypoints.distant import random_distant_view
from fgrecon_research.training.keypoints.labels import SEEN, Labels, ShapeFit, project_labels, surface_of
from fgrecon_research.training.keypoints.posed_cars import PosedCar, Progress, no_progress
from fgrecon_research.training.keypoints.views import Views

SIDE = 192
"""Longest side of the prepared photographs, pixels."""

_SEED = 11_000_000  # of the distances from which photographs are seen again
_FILES = ("images.npy", "masks.npy", "sizes.npy", "scales.npy")
_DISTANT = "distant.npz"
LAST = _FILES[-1]
"""Name of the file that is written last: where it is, all are."""


def check_prepared(folder: Path) -> bool:
    """See that what `prepare_photographs` wrote can be read; True.

    Raises:
        InvalidInputError: A file is missing or damaged; names it.
    """
    lengths = set()
    for name in (*_FILES, _DISTANT):
        try:
            if name == _DISTANT:
                read_arrays(folder / name, str(folder / name), MADE_AGAIN)
            else:
                lengths.add(len(np.load(folder / name, mmap_mode="r")) // (1 if name == LAST else 2))
        except Exception as error:  # numpy promises no kind of error for damaged content
            raise InvalidInputError(str(folder), f"{name}: {error}", MADE_AGAIN) from error
    if len(lengths) > 1:
        raise InvalidInputError(str(folder), "arrays of different lengths", MADE_AGAIN)
    return True


@dataclass(frozen=True, eq=False)
class Photographs(Views):
    """Prepared photographs, read from disk on use."""

    images: NDArray[np.uint8]  # (2 M, 192, 192, 3) RGB, each in the upper left corner
    masks: NDArray[np.uint8]  # (2 M, 192, 192) 255 on the car
    sizes: NDArray[np.int64]  # (2 M, 2) width and height; 0 where there is no distant one
    scales: Array  # (M,) prepared pixels per pixel of the file
    keypoints: Array  # (2 M, K, 2) labels in prepared pixels; NaN where unknown
    visible: Array  # (2 M, K) probability that each keypoint can be seen
    azimuth: Array  # (2 M,) direction from the car to the camera, radians
    kinds: NDArray[np.int64]  # (2 M,) as in `LabelledView`

    @classmethod
    def load(cls, folder: Path, labels: Labels, cars: Sequence[PosedCar]) -> Photographs:
        """What `prepare_photographs` wrote, with labels in pixels of the files and the poses that belong to them."""
        images, masks, sizes, scales = (np.load(folder / name, mmap_mode="r") for name in _FILES)
        keypoints = (labels.keypoints + 0.5) * scales[:, None, None] - 0.5
        with np.load(folder / _DISTANT, allow_pickle=False) as far:
            # The distant image was made with the shape of that time: labels that have moved since move in it as well.
            moved = far["after"] + far["ratio"][:, None, None] * (keypoints - far["before"])
            visible = far["visible"]
        return cls(
            images,
            masks,
            np.asarray(sizes),
            np.asarray(scales),
            np.concatenate([keypoints, moved]),
            np.concatenate([labels.visible, visible]),
            np.array(2 * [car.azimuth for car in cars]),
            np.array(2 * [car.kind for car in cars]),
        )

    def with_distant(self, chosen: NDArray[np.intp]) -> NDArray[np.intp]:
        """Photographs, and rows of their distant ones where these exist."""
        again = chosen + len(self.scales)
        return np.concatenate([chosen, again[self.sizes[again, 0] > 0]])

    def view(self, index: int) -> LabelledView:
        """One photograph with its labels."""
        width, height = self.sizes[index]
        return LabelledView(
            np.asarray(self.images[index, :height, :width]),
            np.asarray(self.masks[index, :height, :width]),
            self.keypoints[index],
            self.visible[index],
            float(self.azimuth[index]),
            kind=int(self.kinds[index]),
        )


def prepare_photographs(
    cars: Sequence[PosedCar],
    fits: Sequence[ShapeFit],
    prior: ShapePrior,
    folder: Path,
    silhouettes: Sequence[Path | None] | None = None,
    progress: Progress = no_progress,
) -> None:
    """Resize all photographs, draw their masks and make distant ones, in memory-mapped arrays (0.2 MB a photograph).

    Args:
        folder: Where to write; made if missing.
        silhouettes: Grey image of each that is white on the car, for its mask; None where the shape's projection has to
            do, or for all. Only those that have one are also seen from further away.

    Raises:
        InvalidInputError: A photograph or silhouette cannot be read.
    """
    folder.mkdir(parents=True, exist_ok=True)
    count = len(cars)
    shape = (2 * count, SIDE, SIDE)  # without distant ones the second half is a hole in the file
    images = np.lib.format.open_memmap(folder / _FILES[0], "w+", np.uint8, (*shape, 3))
    masks = np.lib.format.open_memmap(folder / _FILES[1], "w+", np.uint8, shape)
    sizes, scales = np.zeros((2 * count, 2), dtype=np.int64), np.ones(count)
    before, after = np.zeros((2, count, prior.category.size, 2))
    ratio, visible = np.ones(count), np.zeros((count, prior.category.size))
    for i, (car, fit) in progress(list(enumerate(zip(cars, fits, strict=True))), "Photographs"):
        image = read_image(car.image)
        scales[i] = min(1.0, SIDE / max(image.shape[:2]))
        width, height = (max(round(n * float(scales[i])), 1) for n in (image.shape[1], image.shape[0]))
        sizes[i] = width, height
        images[i, :height, :width] = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
        file = None if silhouettes is None else silhouettes[i]
        if file is None:
            masks[i, :height, :width] = draw_mask(car, fit, prior, float(scales[i]))[:height, :width]
            continue
        drawn = read_silhouette(file, car.size)
        masks[i, :height, :width] = cv2.resize(drawn, (width, height), interpolation=cv2.INTER_AREA)
        small = car.resized(float(scales[i]), (width, height))
        taken = np.asarray(images[i, :height, :width]), np.asarray(masks[i, :height, :width])
        distant = random_distant_view(*taken, small, fit, prior, SIDE, np.random.default_rng((_SEED, i)))
        if distant is not None:
            width, height = sizes[count + i] = distant.car.size
            images[count + i, :height, :width], masks[count + i, :height, :width] = distant.image, distant.mask
            labels = project_labels(prior, fit, [distant.car])
            before[i] = small.project(prior.keypoints(fit.coefficients, fit.offsets))
            after[i], visible[i], ratio[i] = labels.keypoints[0], labels.visible[0], distant.scale
            after[i, (visible[i] > SEEN) & ~distant.believes(after[i])] = np.nan
    images.flush()
    masks.flush()
    np.save(folder / _FILES[2], sizes)
    np.savez(folder / _DISTANT, before=before, after=after, ratio=ratio, visible=visible)
    content = io.BytesIO()
    np.save(content, scales)
    write_bytes(folder / _FILES[3], content.getvalue())  # last, and whole: says that all of it is there


def read_silhouette(path: Path, size: tuple[int, int]) -> NDArray[np.uint8]:
    """(H, W) silhouette in a grey image file: 255 on the car, 0 elsewhere.

    Args:
        size: (width, height) of the photograph, pixels.

    Raises:
        InvalidInputError: The file is no image, or of another size.
    """
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise InvalidInputError(str(path), "unreadable", "Give a grey image: white on the car, black elsewhere.")
    if image.shape != (size[1], size[0]):
        raise InvalidInputError(
            str(path), f"{image.shape[1]} x {image.shape[0]}", f"Give {size[0]} x {size[1]} pixels."
        )
    return np.asarray(image, dtype=np.uint8)


def draw_mask(car: PosedCar, fit: ShapeFit, prior: ShapePrior, scale: float = 1.0) -> NDArray[np.uint8]:
    """(192, 192) 255 where the projected surface covers the photograph resized by `scale`."""
    surface = surface_of(prior)
    pixels = (car.project(surface.vertices(fit.coefficients)) + 0.5) * scale - 0.5
    return fill_faces(pixels[surface.faces], SIDE)


def fill_faces(corners: Array, side: int) -> NDArray[np.uint8]:
    """(side, side) 255 inside any of the triangles (F, 3, 2) in pixels."""
    mask = np.zeros((side, side), dtype=np.uint8)
    for triangle in np.clip(np.rint(corners * 16), -1e6, 1e6).astype(np.int32):  # sixteenths of a pixel
        cv2.fillConvexPoly(mask, triangle, (255,), shift=4)
    return mask
