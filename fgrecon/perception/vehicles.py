"""Boxes of the cars in an image by NanoDet-g, on ONNX Runtime or on OpenCV's network module."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.checks import CORNERS, as_finite, check_corners, one_word, own
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.evidence import VehicleClass
from fgrecon.core.geometry import box_overlaps
from fgrecon.core.repr import brief_repr
from fgrecon.io.catalogue import shipped_class_sizes
from fgrecon.io.files import check_hash, listed
from fgrecon.io.isolated import Isolated
from fgrecon.perception.keypoints.decode import sigmoid
from fgrecon.perception.keypoints.detect import as_rgb8
from fgrecon.perception.keypoints.sessions import Network, open_session, runs_on, threads_of_networks

INPUT = "image"
"""Name of the network's input: (1, 3, H, W) RGB from 0 to 1, less a mean; H and W are multiples of 32, from 64."""

STRIDES = (8, 16, 32)
"""Pixels of the input from one cell to the next, of each of its outputs."""

CLASSES, DISTANCES = 80, 11
"""Of COCO; and of a box's edge from the cell's centre, 0 to 10 cells."""

CHANNELS = CLASSES + 4 * DISTANCES
"""Of each output: classes, then distances to the left, upper, right and lower edge."""

MEAN = (123.675, 116.28, 103.53)
"""Red, green and blue that it takes for nothing, from 0 to 255."""

_NAME = "vehicles-nanodet-g.onnx"
VEHICLE_NAMES = ("car", "bus", "train", "truck")
"""What COCO calls vehicles that are no two-wheelers, in its order; the network finds boxes of cars."""

_CAR, *_OTHERS = 2, 5, 6, 7  # of COCO's classes, in the order of these names
_ANY_CLASS = VehicleClass({"car": 0.0})  # as often as each is among all
_MULTIPLE = 32
_LEAST_SIDE = 64  # OpenCV 5.0 enlarges a map of one column to garbage


@dataclass(frozen=True)
class NetworkPass:
    """One run of the network over the image."""

    area_px: int  # of the input. Images are not enlarged
    min_side: float = 0.0  # boxes whose longer side is a smaller share of the image's are left to another pass


@dataclass(frozen=True)
class DetectionSettings:
    """How the network is used.

    Attributes:
        passes: One for cars in a street, one for those that fill the image, which the first does not see as a whole.
        min_score: Boxes below this are left out.
        max_overlap: Of two boxes from which on they are one car, intersection over union.
        score_slope: Of the logistic regression from the class's number to the score, fitted on KITTI's 19 images.
        score_offset: Its constant, likewise.
        class_score: Boxes from this on say of which class a vehicle is: vans are no good cars. Not tuned.
    """

    passes: tuple[NetworkPass, ...] = (NetworkPass(928 * 288), NetworkPass(256 * 80, 0.4))
    min_score: float = 0.35
    max_overlap: float = 0.5
    score_slope: float = 3.4
    score_offset: float = 1.25
    class_score: float = 0.02


SETTINGS = DetectionSettings()


@dataclass(frozen=True, eq=False)
class Vehicles:
    """What was detected in an image, by falling score.

    Attributes:
        boxes: (N, 4) x1, y1, x2, y2 of the cars' outlines, as far as they are in the image, pixels.
        scores: (N,) from 0 to 1; whether they are probabilities is said by what detected them.
        kinds: What each is, one word such as `Van`, which results of videos repeat; empty where that is not known.
        classes: Which class each is of, as evidence of its size; empty where that is not known.
        tracks: Ids by a tracker, which results repeat; empty without one.
    """

    boxes: Array
    scores: Array
    kinds: tuple[str, ...] = ()
    classes: tuple[VehicleClass, ...] = ()
    tracks: tuple[int, ...] = ()

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        """Check the arrays.

        Raises:
            InvalidInputError: A shape is wrong, a number is not finite, or a box has no size.
        """
        boxes = as_finite("vehicles.boxes", self.boxes, (None, 4), CORNERS)
        check_corners("vehicles.boxes", boxes)
        object.__setattr__(self, "boxes", own(boxes))
        object.__setattr__(self, "scores", own(as_finite("vehicles.scores", self.scores, (len(boxes),))))
        kinds = tuple(one_word(f"vehicles.kinds[{i}]", kind) for i, kind in enumerate(self.kinds))
        object.__setattr__(self, "kinds", kinds)
        object.__setattr__(self, "tracks", tuple(map(int, self.tracks)))
        for name in ("kinds", "classes", "tracks"):
            if (count := len(getattr(self, name))) not in (0, len(boxes)):
                raise InvalidInputError(
                    f"vehicles.{name}", f"{count} for {len(boxes)} boxes", "Give one each, or none."
                )
        if len(set(self.tracks)) < len(self.tracks) or min(self.tracks, default=0) < 0:
            raise InvalidInputError("vehicles.tracks", list(self.tracks), "Give each vehicle its own id, from 0 on.")

    def __len__(self) -> int:
        """Number of cars."""
        return len(self.boxes)

    def take(self, index: NDArray[np.intp]) -> Vehicles:
        """Those at an index."""
        each = (tuple(some[i] for i in index) if some else () for some in (self.kinds, self.classes, self.tracks))
        return Vehicles(self.boxes[index], self.scores[index], *each)


class NanodetVehicleDetector:
    """NanoDet-g, the detector that comes with the package, loaded once. One thread at a time may use it.

    Scores are the probability that the box overlaps a car's by more than half, as on KITTI's images.

    Attributes:
        device: Where it runs: `cpu`, or the given one where ONNX Runtime has it.
    """

    def __init__(self, weights: str | Path | None = None, *, device: str = "cpu") -> None:
        """Load it.

        Args:
            weights: ONNX file by `fgrecon vehicles convert`; None for the one that comes with fgrecon.
            device: `cpu`, with as many threads as cores are free now, and not more than OpenCV has; or that of a GPU,
                such as `cuda`; the processor where ONNX Runtime has it not.

        Raises:
            InvalidInputError: There is no such file, or no network or another one in it.
        """
        self.device = device if runs_on(device) else "cpu"
        self._path = path = shipped() if weights is None else Path(weights)
        fix = "Give an ONNX file that `fgrecon vehicles convert` wrote."
        if not path.is_file():
            raise InvalidInputError("weights", str(path), fix)
        try:
            model = path.read_bytes()
            check_hash(path, model)
            if path.name not in listed(path.parent):
                with Isolated() as child:  # a damaged one can end the process that runs it
                    child("weights", _try, model)
            self._network = _network_of(model, self.device)
            maps = self._network(np.zeros((1, 3, _LEAST_SIDE, _LEAST_SIDE), np.float32))
        except (OSError, InvalidInputError) as error:
            raise InvalidInputError("weights", str(path), fix) from error
        channels = [found.shape[1] for found in maps]
        if channels != [CHANNELS] * len(STRIDES):
            raise InvalidInputError("weights", f"maps of {channels} numbers in {path}", fix)

    def __reduce__(self) -> tuple[Any, ...]:
        """How another process makes it: from the file, which must still be there."""
        return partial(type(self), device=self.device), (self._path,)

    def __call__(self, image: NDArray[Any], *, least_score: float | None = None) -> Vehicles:
        """The cars in an image.

        Args:
            image: (H, W, 3) RGB or (H, W) grey, 8 or 16 bits; or (H, W, 4) with transparency, which is dropped.
            least_score: Boxes below this are left out, 0 to 1; None for what suits the network.

        Raises:
            InvalidInputError: The image is none, or the score is not between 0 and 1.
        """
        least = SETTINGS.min_score if least_score is None else least_score
        if not 0.0 < least <= 1.0:
            raise InvalidInputError("least_score", least_score, "Give a number above 0 and up to 1.")
        pixels = as_rgb8(image)
        height, width = pixels.shape[:2]
        boxes, scores, numbers = self._passes(pixels, min(least, SETTINGS.class_score))
        likely = np.flatnonzero(scores >= least)
        kept = likely[suppress(boxes[likely], scores[likely], SETTINGS.max_overlap)]
        inside = np.clip(boxes[kept], 0.0, [width - 1.0, height - 1.0] * 2)
        kept = kept[visible := (inside[:, 2:] > inside[:, :2]).all(axis=1)]  # not beyond the border as a whole
        averaged = _mean_numbers(boxes[kept], boxes, scores, numbers)
        classes = tuple(_class_of(one) for one in averaged if one is not None)  # each is about itself
        return Vehicles(inside[visible], scores[kept], classes=classes)

    def class_numbers(self, image: NDArray[Any], boxes: Array) -> list[Array | None]:
        """What the network says of the classes of vehicles in boxes (N, 4): (4,) each, or None where it sees none.

        They are its numbers of `VEHICLE_NAMES`, averaged over its boxes about the vehicle by their scores.

        Args:
            image: As it is called with.
            boxes: x1, y1, x2, y2 in pixels.

        Raises:
            InvalidInputError: The image is none.
        """
        return _mean_numbers(boxes, *self._passes(as_rgb8(image), SETTINGS.class_score))

    def classes_of(self, image: NDArray[Any], boxes: Array) -> list[VehicleClass]:
        """Of which class the vehicles in boxes (N, 4) are, as `class_numbers`; where it sees none, of any class."""
        return [_ANY_CLASS if one is None else _class_of(one) for one in self.class_numbers(image, boxes)]

    def _passes(self, pixels: NDArray[np.uint8], least_score: float) -> tuple[Array, Array, Array]:
        """Boxes (M, 4), scores (M,) and numbers (M, 4) of all passes over an image, one vehicle in many boxes."""
        passes = [self._detect(pixels, one, least_score) for one in SETTINGS.passes]
        boxes, scores, numbers = (np.concatenate(each) for each in zip(*passes, strict=True))
        return boxes, scores, numbers

    def _detect(self, pixels: NDArray[np.uint8], one: NetworkPass, least_score: float) -> tuple[Array, Array, Array]:
        """Boxes (M, 4) in pixels of the image, scores (M,), numbers (M, 4), from the image scaled about to the area."""
        import cv2

        height, width = pixels.shape[:2]
        scale = np.sqrt(min(one.area_px, width * height) / (width * height))
        size = tuple(max(_LEAST_SIDE, _MULTIPLE * round(side * scale / _MULTIPLE)) for side in (width, height))
        scaled = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR)
        maps = self._network(cv2.dnn.blobFromImage(scaled, 1.0 / 255.0, mean=MEAN))
        boxes, scores, numbers = decode(maps, size[0], least_score)
        boxes = boxes * np.tile([width / size[0], height / size[1]], 2) - 0.5  # pixel centres are at integers
        inside = np.clip(boxes, 0.0, [width, height] * 2)
        large = (inside[:, 2:] - inside[:, :2]).max(axis=1) >= one.min_side * max(width, height)
        return boxes[large], scores[large], numbers[large]


def _mean_numbers(vehicles: Array, boxes: Array, scores: Array, numbers: Array) -> list[Array | None]:
    """Of each vehicle (N, 4) the mean of numbers (M, 4) of the boxes (M, 4) about it, by scores (M,); None of none."""
    if not len(boxes):
        return [None] * len(vehicles)
    overlap = box_overlaps(vehicles, boxes)
    weight = np.where(overlap > SETTINGS.max_overlap, overlap * scores, 0.0)
    found = ((one, float(one.sum())) for one in weight)
    return [one @ numbers / total if total > 0.0 else None for one, total in found]


def _class_of(numbers: Array) -> VehicleClass:
    """Of which class a vehicle is of which the network gives numbers (4,) of `VEHICLE_NAMES`."""
    margin = float(numbers[VEHICLE_NAMES.index("truck")] - numbers[0])
    return VehicleClass(shipped_class_sizes().detected(VEHICLE_NAMES[int(numbers.argmax())], margin))


def decode(maps: Sequence[NDArray[np.floating]], width: int, least_score: float) -> tuple[Array, Array, Array]:
    """Boxes (M, 4) of cars, their scores (M,) and numbers (M, 4) from the network's raw maps, one car in many boxes.

    The distance of each edge from its cell's centre is the mean of a distribution over 0 to 10 cells. The class's
    number tells both, whether it is a car and how well the box fits; the score is a logistic regression on it.

    Args:
        maps: (1, 80 + 4 * 11, h, w) of every stride, in any order.
        width: Of the network's input, which tells the strides apart, pixels.
        least_score: Boxes below this are left out.

    Returns:
        Boxes as x1, y1, x2, y2 in pixels of the input, its left and upper edge at 0; and the network's numbers (logits)
        of `VEHICLE_NAMES` there.
    """
    boxes, scores, classes = [], [], []
    for numbers in maps:
        stride = width // numbers.shape[3]
        car = np.asarray(numbers[0, _CAR], dtype=np.float64)
        score = sigmoid(SETTINGS.score_slope * car + SETTINGS.score_offset)
        row, column = np.nonzero(score >= least_score)
        logits = np.asarray(numbers[0, CLASSES:, row, column], dtype=np.float64).reshape(-1, 4, DISTANCES)
        share = np.exp(logits - logits.max(axis=2, keepdims=True))
        left_up, right_down = np.split(share @ np.arange(DISTANCES) / share.sum(axis=2), 2, axis=1)
        centre = np.stack([column, row], axis=1) + 0.5
        boxes.append(stride * np.hstack([centre - left_up, centre + right_down]))
        scores.append(score[row, column])
        classes.append(np.asarray(numbers[0, [_CAR, *_OTHERS]][:, row, column].T, dtype=np.float64))
    return np.concatenate(boxes), np.concatenate(scores), np.concatenate(classes)


def _network_of(model: bytes, device: str = "cpu") -> Network:
    import cv2

    return open_session(model, min(cv2.getNumThreads(), threads_of_networks()), device)


def _try(model: bytes) -> None:
    """Run a network once."""
    try:
        _network_of(model)(np.zeros((1, 3, _LEAST_SIDE, _LEAST_SIDE), np.float32))
    except InvalidInputError:
        raise
    except (RuntimeError, ValueError) as error:
        raise InvalidInputError("weights", str(error), "Give an ONNX file of a network.") from error


def suppress(boxes: Array, scores: Array, overlap: float) -> NDArray[np.int64]:
    """Which boxes (M, 4) stay, by falling score (M,): those that no better one overlaps by more than that."""
    import cv2

    corner_and_size = np.hstack([boxes[:, :2], boxes[:, 2:] - boxes[:, :2]])
    kept = cv2.dnn.NMSBoxes(corner_and_size.tolist(), scores.tolist(), 0.0, overlap)
    return np.asarray(kept, dtype=np.int64).reshape(-1)


def shipped() -> Path:
    """The file that comes with the package; an installation may lack it."""
    return Path(str(resources.files("fgrecon") / "data" / "weights" / _NAME))
