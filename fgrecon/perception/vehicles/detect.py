"""Boxes of the cars in an image, by YOLOv4-tiny on ONNX Runtime or on OpenCV's network module."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.brief import brief_repr
from fgrecon.core.checks import as_finite
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.renamed import renamed
from fgrecon.perception.keypoints.detect import as_rgb8
from fgrecon.perception.keypoints.sessions import Network, chosen_runtime, open_session

__all__ = ["HEADS", "INPUT", "Head", "Vehicles", "YoloVehicleDetector", "decode", "shipped", "suppress"]

__getattr__ = renamed(__name__, {"VehicleDetector": "YoloVehicleDetector"})

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Head:
    """One of the network's outputs.

    Attributes:
        stride: Pixels of the input from one cell to the next.
        anchors: Width and height of the boxes that each cell starts from, pixels of the input.
        stretch: Width of the range of a box's centre, in cells (Darknet's `scale_x_y`).
    """

    stride: int
    anchors: tuple[tuple[float, float], ...]
    stretch: float


HEADS = (
    Head(32, ((81.0, 82.0), (135.0, 169.0), (344.0, 319.0)), 1.05),
    Head(16, ((23.0, 27.0), (37.0, 58.0), (81.0, 82.0)), 1.05),
)
"""Outputs of YOLOv4-tiny, in the order of its layers."""

INPUT = "image"
"""Name of its input: (1, 3, H, W) RGB from 0 to 1; H and W are multiples of 32."""

_NAME = "vehicles-yolov4-tiny.onnx"
_MULTIPLE = 32
_LOOKS = (1024 * 320, 256 * 80)
"""Areas of the input in pixels: one for cars in a street, one for those that fill the image, which the first does not
see as a whole."""

_CLASSES, _CAR = 80, 2  # of COCO
_LEAST_SCORE = 0.3
_OVERLAP = 0.45  # of two boxes of one car, intersection over union


@dataclass(frozen=True, eq=False)
class Vehicles:
    """What was found in an image, by falling score.

    Attributes:
        boxes: (N, 4) x1, y1, x2, y2 of the cars' outlines, as far as they are in the image, pixels.
        scores: (N,) from 0 to 1; not calibrated.
    """

    boxes: Array
    scores: Array

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
        object.__setattr__(self, "boxes", boxes)
        object.__setattr__(self, "scores", as_finite("vehicles.scores", self.scores, (len(boxes),)))

    def __len__(self) -> int:
        """Number of cars."""
        return len(self.boxes)


class YoloVehicleDetector:
    """YOLOv4-tiny, loaded once. One thread at a time may use it.

    Attributes:
        runtime: What runs it: "opencv" or "onnx". Boxes are the same to 0.01 pixels.
    """

    def __init__(self, weights: str | Path | None = None, *, runtime: str = "auto") -> None:
        """Load it.

        Args:
            weights: ONNX file by `fgrecon vehicles convert`; None for the one that comes with the package.
            runtime: What runs the network: "opencv"; "onnx", which is ONNX Runtime, with as many threads as OpenCV has
                now; or "auto", "onnx" where it is installed.

        Raises:
            InvalidInputError: There is no such file, no network in it, or the runtime is not installed.
        """
        import cv2

        self.runtime = chosen_runtime(runtime, "opencv", packages=["onnxruntime"])
        path = shipped() if weights is None else Path(weights)
        fix = "Give an ONNX file that `fgrecon vehicles convert` wrote."
        if not path.is_file():
            raise InvalidInputError("weights", str(path), fix)
        try:
            model = path.read_bytes()
            self._network = open_session(model, cv2.getNumThreads()) if self.runtime == "onnx" else _on_opencv(model)
        except (OSError, InvalidInputError, cv2.error) as error:
            raise InvalidInputError("weights", str(path), fix) from error

    def __call__(self, image: NDArray[Any], *, least_score: float = _LEAST_SCORE) -> Vehicles:
        """The cars in an image.

        Args:
            image: (H, W, 3) RGB or (H, W) grey, 8 or 16 bits; or (H, W, 4) with transparency, which is dropped.
            least_score: Boxes below this are left out, 0 to 1.

        Raises:
            InvalidInputError: The image is none, or the score is not between 0 and 1.
        """
        if not 0.0 < least_score <= 1.0:
            raise InvalidInputError("least_score", least_score, "Give a number above 0 and up to 1.")
        pixels = as_rgb8(image)
        height, width = pixels.shape[:2]
        looks = [self._look(pixels, min(area, width * height), least_score) for area in _LOOKS]
        boxes = np.concatenate([boxes for boxes, _ in looks])
        scores = np.concatenate([scores for _, scores in looks])
        kept = suppress(boxes, scores)
        inside = np.clip(boxes[kept], 0.0, [width - 1.0, height - 1.0] * 2)
        seen = (inside[:, 2:] > inside[:, :2]).all(axis=1)  # not beyond the border as a whole
        return Vehicles(inside[seen], scores[kept][seen])

    def _look(self, pixels: NDArray[np.uint8], area: int, least_score: float) -> tuple[Array, Array]:
        """Boxes (M, 4) in pixels of the image and scores (M,), from the image scaled to about an area."""
        import cv2

        height, width = pixels.shape[:2]
        scale = np.sqrt(area / (width * height))
        size = tuple(_MULTIPLE * max(1, round(side * scale / _MULTIPLE)) for side in (width, height))
        scaled = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR)
        maps = self._network(cv2.dnn.blobFromImage(scaled, 1.0 / 255.0))
        boxes, scores = decode(maps, size[0], least_score)
        return boxes * np.tile([width / size[0], height / size[1]], 2) - 0.5, scores  # pixel centres are at integers


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


def decode(maps: Sequence[NDArray[np.floating]], width: int, least_score: float) -> tuple[Array, Array]:
    """Boxes (M, 4) of cars and their scores (M,) from the network's raw maps, one car in many boxes.

    A box's centre is its cell's centre moved by the stretched sigmoids of the first two numbers, its size the anchor's
    times the exponentials of the next two; its score is the sigmoid of the fifth (something is here) times that of the
    class.

    Args:
        maps: (1, 3 * 85, h, w) of every head, in any order.
        width: Of the network's input, which tells the heads apart, pixels.
        least_score: Boxes below this are left out.

    Returns:
        Boxes as x1, y1, x2, y2 in pixels of the input, its left and upper edge at 0.
    """
    heads = {head.stride: head for head in HEADS}
    boxes, scores = [], []
    for numbers in maps:
        rows, columns = numbers.shape[2:]
        head = heads[width // columns]
        cells = np.asarray(numbers, dtype=np.float64).reshape(len(head.anchors), 5 + _CLASSES, rows, columns)
        score = _sigmoid(cells[:, 4]) * _sigmoid(cells[:, 5 + _CAR])
        anchor, row, column = np.nonzero(score >= least_score)
        x, y, w, h = cells[anchor, :4, row, column].T
        offset = head.stretch * (_sigmoid(np.stack([x, y], axis=1)) - 0.5) + 0.5
        centre = head.stride * (offset + np.stack([column, row], axis=1))
        half = np.exp(np.stack([w, h], axis=1)) * np.array(head.anchors)[anchor] / 2.0
        boxes.append(np.hstack([centre - half, centre + half]))
        scores.append(score[anchor, row, column])
    return np.concatenate(boxes), np.concatenate(scores)


def suppress(boxes: Array, scores: Array) -> NDArray[np.int64]:
    """Which boxes (M, 4) stay, by falling score (M,): those that no better one overlaps by more than 0.45."""
    import cv2

    corner_and_size = np.hstack([boxes[:, :2], boxes[:, 2:] - boxes[:, :2]])
    kept = cv2.dnn.NMSBoxes(corner_and_size.tolist(), scores.tolist(), 0.0, _OVERLAP)
    return np.asarray(kept, dtype=np.int64).reshape(-1)


def shipped() -> Path:
    """The file that comes with the package; an installation may lack it."""
    return Path(str(resources.files("fgrecon") / "data" / "weights" / _NAME))


def _sigmoid(x: Array) -> Array:
    return np.asarray(0.5 * (1.0 + np.tanh(0.5 * x)))
