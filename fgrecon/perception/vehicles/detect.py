"""Boxes of the cars in an image, by a network on ONNX Runtime or on OpenCV's network module."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.brief import brief_repr
from fgrecon.core.checks import as_finite, one_word, own
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.hashes import check_hash, listed
from fgrecon.io.isolated import Isolated
from fgrecon.perception.keypoints.detect import as_rgb8
from fgrecon.perception.keypoints.sessions import Network, chosen_runtime, open_session
from fgrecon.perception.vehicles import nanodet, yolo

__all__ = [
    "INPUT",
    "DetectorSettings",
    "Look",
    "NanodetVehicleDetector",
    "NetworkDetector",
    "Vehicles",
    "YoloVehicleDetector",
    "shipped",
    "suppress",
]


Array = NDArray[np.float64]


INPUT = "image"
"""Name of the networks' input: (1, 3, H, W) RGB from 0 to 1, less a mean; H and W are multiples of 32, from 64."""

_NAME = "vehicles-nanodet-g.onnx"
_MULTIPLE = 32
_LEAST_SIDE = 64  # OpenCV 5.0 enlarges a map of one column to garbage


@dataclass(frozen=True)
class Look:
    """One run of a network over the image.

    Attributes:
        area: Of the input, pixels. Images are not enlarged.
        least_side: Boxes whose longer side is a smaller share of the image's are left to another look.
    """

    area: int
    least_side: float = 0.0


@dataclass(frozen=True)
class DetectorSettings:
    """How a kind of network is asked, and how its answer is read.

    Attributes:
        mean: Red, green and blue from 0 to 255 that are taken off.
        looks: One for cars in a street, one for those that fill the image, which the first does not see as a whole.
        least_score: Boxes below this are left out.
        overlap: Of two boxes from which on they are one car, intersection over union.
        channels: Of each of the network's maps.
        decode: Boxes and scores from the maps, the input's width and the least score.
    """

    mean: tuple[float, float, float]
    looks: tuple[Look, ...]
    least_score: float
    overlap: float
    channels: tuple[int, ...]
    decode: Callable[[Sequence[NDArray[np.floating]], int, float], tuple[Array, Array]]


@dataclass(frozen=True, eq=False)
class Vehicles:
    """What was found in an image, by falling score.

    Attributes:
        boxes: (N, 4) x1, y1, x2, y2 of the cars' outlines, as far as they are in the image, pixels.
        scores: (N,) from 0 to 1; whether they are probabilities is said by what found them.
        kinds: What each is, one word such as `Van`, which results of videos repeat; empty where that is not told.
    """

    boxes: Array
    scores: Array
    kinds: tuple[str, ...] = ()

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        """Check the arrays.

        Raises:
            InvalidInputError: A shape is wrong, a number is not finite, or a box has no size.
        """
        fix = "Give x1, y1, x2, y2 of each vehicle in pixels, x1 < x2 and y1 < y2."
        boxes = as_finite("vehicles.boxes", self.boxes, (None, 4), fix)
        empty = boxes[~(boxes[:, 2:] > boxes[:, :2]).all(axis=1)]
        if len(empty):
            raise InvalidInputError("vehicles.boxes", empty[0].tolist(), fix)
        object.__setattr__(self, "boxes", own(boxes))
        object.__setattr__(self, "scores", own(as_finite("vehicles.scores", self.scores, (len(boxes),))))
        kinds = tuple(one_word(f"vehicles.kinds[{i}]", kind) for i, kind in enumerate(self.kinds))
        if len(kinds) not in (0, len(boxes)):
            raise InvalidInputError("vehicles.kinds", f"{len(kinds)} for {len(boxes)} boxes", "Give one each, or none.")
        object.__setattr__(self, "kinds", kinds)

    def __len__(self) -> int:
        """Number of cars."""
        return len(self.boxes)


class NetworkDetector:
    """A network, loaded once. One thread at a time may use it.

    Attributes:
        settings: How it is asked.
        runtime: What runs it: "opencv" or "onnx". Boxes are the same to 0.01 pixels.
    """

    settings: DetectorSettings

    def __init__(self, weights: str | Path, *, runtime: str = "auto") -> None:
        """Load it.

        Args:
            weights: ONNX file by `fgrecon vehicles convert`.
            runtime: What runs the network: "opencv"; "onnx", which is ONNX Runtime, with as many threads as OpenCV has
                now; or "auto", "onnx" where it is installed.

        Raises:
            InvalidInputError: There is no such file, no network or another one in it, or the runtime is not installed.
        """
        import cv2

        self.runtime = chosen_runtime(runtime, "opencv", packages=["onnxruntime"])
        self._path = path = Path(weights)
        fix = "Give an ONNX file that `fgrecon vehicles convert` wrote."
        if not path.is_file():
            raise InvalidInputError("weights", str(path), fix)
        try:
            model = path.read_bytes()
            check_hash(path, model)
            if path.name not in listed(path.parent):
                with Isolated() as child:  # a damaged one can end the process that runs it
                    child("weights", _try, model, self.runtime)
            self._network = _network_of(model, self.runtime)
        except (OSError, InvalidInputError, cv2.error) as error:
            raise InvalidInputError("weights", str(path), fix) from error
        channels = tuple(
            found.shape[1] for found in self._network(np.zeros((1, 3, _LEAST_SIDE, _LEAST_SIDE), np.float32))
        )
        if channels != self.settings.channels:
            fix = f"Give {type(self).__name__} its own: these have maps of {channels} numbers."
            raise InvalidInputError("weights", str(path), fix)

    def __reduce__(self) -> tuple[Any, ...]:
        """How another process makes it: from the file, which must still be there."""
        return partial(type(self), runtime=self.runtime), (self._path,)

    def __call__(self, image: NDArray[Any], *, least_score: float | None = None) -> Vehicles:
        """The cars in an image.

        Args:
            image: (H, W, 3) RGB or (H, W) grey, 8 or 16 bits; or (H, W, 4) with transparency, which is dropped.
            least_score: Boxes below this are left out, 0 to 1; None for what suits the network.

        Raises:
            InvalidInputError: The image is none, or the score is not between 0 and 1.
        """
        least = self.settings.least_score if least_score is None else least_score
        if not 0.0 < least <= 1.0:
            raise InvalidInputError("least_score", least_score, "Give a number above 0 and up to 1.")
        pixels = as_rgb8(image)
        height, width = pixels.shape[:2]
        looks = [self._look(pixels, look, least) for look in self.settings.looks]
        boxes = np.concatenate([boxes for boxes, _ in looks])
        scores = np.concatenate([scores for _, scores in looks])
        kept = suppress(boxes, scores, self.settings.overlap)
        inside = np.clip(boxes[kept], 0.0, [width - 1.0, height - 1.0] * 2)
        seen = (inside[:, 2:] > inside[:, :2]).all(axis=1)  # not beyond the border as a whole
        return Vehicles(inside[seen], scores[kept][seen])

    def _look(self, pixels: NDArray[np.uint8], look: Look, least_score: float) -> tuple[Array, Array]:
        """Boxes (M, 4) in pixels of the image and scores (M,), from the image scaled to about the look's area."""
        import cv2

        height, width = pixels.shape[:2]
        scale = np.sqrt(min(look.area, width * height) / (width * height))
        size = tuple(max(_LEAST_SIDE, _MULTIPLE * round(side * scale / _MULTIPLE)) for side in (width, height))
        scaled = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR)
        maps = self._network(cv2.dnn.blobFromImage(scaled, 1.0 / 255.0, mean=self.settings.mean))
        boxes, scores = self.settings.decode(maps, size[0], least_score)
        boxes = boxes * np.tile([width / size[0], height / size[1]], 2) - 0.5  # pixel centres are at integers
        inside = np.clip(boxes, 0.0, [width, height] * 2)
        large = (inside[:, 2:] - inside[:, :2]).max(axis=1) >= look.least_side * max(width, height)
        return boxes[large], scores[large]


class NanodetVehicleDetector(NetworkDetector):
    """NanoDet-g, the detector that comes with the package.

    Scores are the probability that the box overlaps a car's by more than half, as on KITTI's images.
    """

    settings = DetectorSettings(
        nanodet.MEAN, (Look(928 * 288), Look(256 * 80, 0.4)), 0.35, 0.5, nanodet.CHANNELS, nanodet.decode
    )

    def __init__(self, weights: str | Path | None = None, *, runtime: str = "auto") -> None:
        """Load it.

        Args:
            weights: ONNX file by `fgrecon vehicles convert --package`; None for the one that comes with fgrecon.
            runtime: As for `NetworkDetector`.

        Raises:
            InvalidInputError: There is no such file, no network in it, or the runtime is not installed.
        """
        super().__init__(shipped() if weights is None else weights, runtime=runtime)


class YoloVehicleDetector(NetworkDetector):
    """YOLOv4-tiny, from a file that `fgrecon vehicles convert --cfg --weights` wrote. Scores are no probabilities."""

    settings = DetectorSettings(
        (0.0, 0.0, 0.0), (Look(1024 * 320), Look(256 * 80)), 0.3, 0.45, yolo.CHANNELS, yolo.decode
    )


def _network_of(model: bytes, runtime: str) -> Network:
    import cv2

    return open_session(model, cv2.getNumThreads()) if runtime == "onnx" else _on_opencv(model)


def _try(model: bytes, runtime: str) -> None:
    """Run a network once.

    Raises:
        InvalidInputError: It cannot be run.
    """
    import cv2

    try:
        _network_of(model, runtime)(np.zeros((1, 3, _LEAST_SIDE, _LEAST_SIDE), np.float32))
    except InvalidInputError:
        raise
    except (cv2.error, RuntimeError, ValueError) as error:
        raise InvalidInputError("weights", str(error), "Give an ONNX file of a network.") from error


def _on_opencv(model: bytes) -> Network:
    """The network of an ONNX file on OpenCV."""
    import cv2

    network = cv2.dnn.readNetFromONNX(np.frombuffer(model, np.uint8))
    names = network.getUnconnectedOutLayersNames()

    def run(blob: NDArray[Any]) -> Sequence[NDArray[np.float32]]:
        network.setInput(blob, INPUT)
        maps: Sequence[NDArray[np.float32]] = network.forward(names)
        return maps

    return run


def suppress(boxes: Array, scores: Array, overlap: float) -> NDArray[np.int64]:
    """Which boxes (M, 4) stay, by falling score (M,): those that no better one overlaps by more than that."""
    import cv2

    corner_and_size = np.hstack([boxes[:, :2], boxes[:, 2:] - boxes[:, :2]])
    kept = cv2.dnn.NMSBoxes(corner_and_size.tolist(), scores.tolist(), 0.0, overlap)
    return np.asarray(kept, dtype=np.int64).reshape(-1)


def shipped() -> Path:
    """The file that comes with the package; an installation may lack it."""
    return Path(str(resources.files("fgrecon") / "data" / "weights" / _NAME))
