"""Street cars with labelled keypoints, cut from the images of drives and kept in memory-mapped arrays."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.metrics import wrap_angle
from fgrecon.io.arrays import read_arrays, write_arrays
from fgrecon.io.coco_keypoints import read_coco_keypoints
from fgrecon.io.files import MADE_AGAIN
from fgrecon.io.images import read_image
from fgrecon.perception.keypoints.crops import Crop, extract
from fgrecon.perception.keypoints.layout import KINDS
from fgrecon_research.training.keypoints.dataset import SIDE, Photographs
from fgrecon_research.training.keypoints.deform import UNKNOWN_KIND, LabelledView
from fgrecon_research.training.keypoints.posed_cars import Progress, no_progress
from fgrecon_research.training.keypoints.views import Together, TrainingSet, Views, azimuth_weights

_AROUND = 1.5  # side of what is kept relative to the box's longer side
_FILES = "images.npy", "masks.npy"
LAST = "cars.npz"
"""Name of the file that is written last: where it is, all are."""
_EVEN = 0.7, 6.0  # how far directions are evened out, as for `azimuth_weights`
_REAR = 1.3  # rear views are where networks err, and mostly what a camera in traffic sees
_OTHER = 1.5  # vans and lorries are rare, and look less alike than cars
_KINDS = {"Car": KINDS.index("car"), "Van": KINDS.index("van"), "Truck": KINDS.index("lorry")}
_WITHOUT_KEYPOINTS = "Truck"  # a car's keypoints are nowhere on it: it teaches direction and kind


@dataclass(frozen=True, eq=False)
class StreetCars(Views):
    """Cars in their street, read from disk on use."""

    images: NDArray[np.uint8]  # (M, 192, 192, 3) RGB around each car
    masks: NDArray[np.uint8]  # (M, 192, 192) 255 on what can be seen of the car
    boxes: Array  # (M, 4) 2D box in them
    keypoints: Array  # (M, K, 2) pixels
    visible: Array  # (M, K) probability that each can be seen
    azimuth: Array  # (M,) direction from the car to the camera, radians
    drives: NDArray[np.str_]  # (M,) names
    tracks: NDArray[np.int64]  # (M,) number of the vehicle within its drive
    kinds: NDArray[np.str_]  # (M,) as labelled

    @classmethod
    def load(cls, folder: Path) -> StreetCars:
        """What `prepare_street_cars` wrote.

        Raises:
            InvalidInputError: There is nothing, or it is damaged.
        """
        if not (folder / LAST).exists():
            raise InvalidInputError("street", str(folder), "Give a folder that a training prepared.")
        table = read_arrays(folder / LAST, str(folder / LAST), MADE_AGAIN)
        try:
            images, masks = (np.load(folder / name, mmap_mode="r") for name in _FILES)
            return cls(images, masks, **table)
        except Exception as error:  # numpy promises no kind of error for damaged content
            raise InvalidInputError(str(folder), f"damaged: {error}", MADE_AGAIN) from error

    def view(self, index: int) -> LabelledView:
        """One car with its labels."""
        return LabelledView(
            np.asarray(self.images[index]),
            np.asarray(self.masks[index]),
            self.keypoints[index],
            self.visible[index],
            float(self.azimuth[index]),
            self.boxes[index],
            _KINDS.get(str(self.kinds[index]), UNKNOWN_KIND),
        )

    def weights(self, chosen: NDArray[np.intp]) -> Array:
        """Probabilities of drawing each.

        Directions are about evened out but for more rear views, and a long track comes not as often as it is long.
        """
        names = np.char.add(np.char.add(self.drives[chosen], " "), self.tracks[chosen].astype(str))
        _, which, count = np.unique(names, return_inverse=True, return_counts=True)
        weight = azimuth_weights(self.azimuth, chosen, *_EVEN) / np.sqrt(count[which])
        weight = weight * np.where(np.abs(wrap_angle(self.azimuth[chosen])) > np.pi / 2.0, _REAR, 1.0)
        weight = weight * np.where(self.kinds[chosen] == "Car", 1.0, _OTHER)
        return weight / weight.sum()


@dataclass(frozen=True, eq=False)
class StreetShare:
    """Street cars beside photographs."""

    cars: StreetCars  # the street cars
    share: float  # of the samples that show one
    without: tuple[str, ...] = ()  # drives whose cars are not learnt from

    def __post_init__(self) -> None:
        """Refuse names that leave nothing out: a mistyped one would let the network learn from what it is scored on.

        Raises:
            InvalidInputError: A drive that is left out is none of the cars'.
        """
        check_drives(self.without, self.cars.drives.tolist())

    @property
    def chosen(self) -> NDArray[np.intp]:
        """Which cars are learnt from."""
        return np.flatnonzero(~np.isin(self.cars.drives, self.without))

    def describe(self) -> str:
        """In words, for the file that keeps what a training began with and for the network's provenance."""
        left_out = f", without {', '.join(self.without)}" if self.without else ""
        return f"{len(self.chosen)} street cars in {self.share:g} of the samples{left_out}"


def check_drives(without: Sequence[str], known: Iterable[str]) -> None:
    """Refuse drives to leave out that are not there.

    Raises:
        InvalidInputError: One is none of the known drives; lists these.
    """
    names = sorted(set(known))
    for name in without:
        if name not in names:
            fix = f"Name drives among {', '.join(names)}." if names else "Leave out drives only where there are some."
            raise InvalidInputError("without", name, fix)


def learning(photographs: Photographs, chosen: NDArray[np.intp], street: StreetShare | None) -> TrainingSet:
    """The chosen photographs, all directions about equally often, and the street cars' share of the samples.

    Raises:
        InvalidInputError: All drives are left out.
    """
    weights = azimuth_weights(photographs.azimuth, chosen)
    if street is None:
        return TrainingSet(photographs, chosen, weights)
    some = street.chosen
    if not len(some):
        raise InvalidInputError("without", ", ".join(street.without), "Leave a drive to learn from.")
    return TrainingSet(
        Together([photographs, street.cars]),
        np.concatenate([chosen, some + len(photographs.azimuth)]),
        np.concatenate([(1.0 - street.share) * weights, street.share * street.cars.weights(some)]),
    )


def prepare_street_cars(file: Path, folder: Path, progress: Progress = no_progress) -> None:
    """Cut the cars of a file out of their images, with what is around them, into a folder (0.15 MB a car).

    Raises:
        InvalidInputError: The file is malformed, holds no vehicle, or an image cannot be read.
    """
    cars = read_coco_keypoints(file).vehicles
    if not cars:
        raise InvalidInputError(f"{file}: annotations", "none", "Give the labels of at least one vehicle.")
    folder.mkdir(parents=True, exist_ok=True)
    shape = (len(cars), SIDE, SIDE)
    images = np.lib.format.open_memmap(folder / _FILES[0], "w+", np.uint8, (*shape, 3))
    masks = np.lib.format.open_memmap(folder / _FILES[1], "w+", np.uint8, shape)
    boxes, keypoints = [], []
    path, image = None, np.zeros((0, 0, 3), dtype=np.uint8)
    for row, car in progress(list(enumerate(cars)), "Street cars"):
        if car.image.path != path:  # the cars of an image come one after the other
            path, image = car.image.path, read_image(car.image.path)
        x1, y1, x2, y2 = car.box
        crop = Crop(np.array([(x1 + x2) / 2, (y1 + y2) / 2]), _AROUND * max(x2 - x1, y2 - y1), SIDE)
        images[row] = extract(image, crop)
        masks[row] = _filled([crop.from_image(polygon) for polygon in car.silhouette])
        boxes.append(crop.from_image(car.box.reshape(2, 2)).ravel())
        known = car.kind != _WITHOUT_KEYPOINTS
        keypoints.append(crop.from_image(car.keypoints) if known else np.full(car.keypoints.shape, np.nan))
    images.flush()
    masks.flush()
    write_arrays(
        folder / LAST,
        boxes=np.array(boxes),
        keypoints=np.array(keypoints),
        visible=np.array([car.probability for car in cars]),
        azimuth=np.array([car.azimuth for car in cars]),
        drives=np.array([car.image.drive for car in cars]),
        tracks=np.array([car.track for car in cars]),
        kinds=np.array([car.kind for car in cars]),
    )


def _filled(polygons: Sequence[Array]) -> NDArray[np.uint8]:
    """255 inside the polygons."""
    mask = np.zeros((SIDE, SIDE), dtype=np.uint8)
    corners = [np.clip(np.rint(polygon * 16), -1e6, 1e6).astype(np.int32) for polygon in polygons]
    if corners:
        cv2.fillPoly(mask, corners, (255,), shift=4)  # sixteenths of a pixel
    return mask
