"""Silhouettes of cars for the first labels, by a salient-object network.

The network is IS-Net (Qin et al., Highly Accurate Dichotomous Image Segmentation, ECCV 2022; MIT licence) as the npm
package `@imgly/background-removal-data` 1.4.5 carries it: an ONNX file in pieces, for images of 1024 x 1024. Nothing of
it becomes part of what is learnt but the outlines of the training's cars. Needs the packages of `fgrecon-research`.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.metrics import wrap_angle
from fgrecon.io.files import write_bytes
from fgrecon.io.images import read_image
from fgrecon_research.training.keypoints.posed_cars import PosedCar, Progress, groups, no_progress

_MODEL = "/models/medium"
_TRAINED_SIDE = 1024
_MIDDLE, _SPREAD = 128.0, 256.0  # of the network's pixel values
_FIX = "Give the unpacked folder of the npm package @imgly/background-removal-data 1.4.5."


def assemble(package: Path) -> bytes:
    """The ONNX file whose pieces an unpacked npm package holds.

    Raises:
        InvalidInputError: The folder is not that package; names what is missing.
    """
    folder = package / "dist"
    try:
        entry = json.loads((folder / "resources.json").read_text(encoding="utf-8"))[_MODEL]
        model = b"".join((folder / str(chunk["hash"])).read_bytes() for chunk in entry["chunks"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InvalidInputError("package", str(package), f"{_FIX} The reason: {error}") from error
    if len(model) != entry.get("size"):
        raise InvalidInputError("package", f"{len(model)} bytes of {entry.get('size')}", _FIX)
    return model


def resized(model: bytes, side: int) -> bytes:
    """The network for images of side x side instead of 1024 x 1024, with its finest output alone.

    Raises:
        InvalidInputError: The side is no multiple of 32.
    """
    import onnx
    from onnx import numpy_helper

    if side < 32 or side % 32:
        raise InvalidInputError("side", side, "Give a multiple of 32.")
    graph = (loaded := onnx.load_model_from_string(model)).graph
    del graph.output[1:], graph.value_info[:]
    for tensor in (graph.input[0], graph.output[0]):
        for dimension in tensor.type.tensor_type.shape.dim[2:]:
            dimension.dim_value = side
    made_by = {name: node for node in graph.node for name in node.output}
    # Every enlargement's size is a constant of its own, or one that several share.
    sizes = {}
    for node in graph.node:
        if node.op_type == "Resize":
            constant = made_by[made_by[node.input[3]].input[1]]
            sizes[constant.name] = constant.attribute[0].t
    for size in sizes.values():
        scaled = numpy_helper.to_array(size) * side // _TRAINED_SIDE
        size.CopyFrom(numpy_helper.from_array(scaled.astype(np.int64)))
    return loaded.SerializeToString()


def in_order(cars: Sequence[PosedCar], each: int) -> list[PosedCar]:
    """Up to `each` photographs of every shape, from directions as different as possible; one of every shape in turn."""
    chosen = [_spread([cars[i] for i in rows], each) for rows in groups(cars).values()]
    return [some[turn] for turn in range(each) for some in chosen if turn < len(some)]


def _spread(cars: Sequence[PosedCar], each: int) -> list[PosedCar]:
    """The largest photograph first, then always the one that is seen from farthest from all before."""
    azimuth = np.array([car.azimuth for car in cars])
    picked = [int(np.argmax([max(car.size) for car in cars]))]
    apart = np.full(len(cars), np.inf)
    while len(picked) < min(each, len(cars)):
        turn = np.abs(wrap_angle(azimuth - azimuth[picked[-1]]))
        apart = np.minimum(apart, turn)
        apart[picked] = -1.0
        picked.append(int(apart.argmax()))
    return [cars[i] for i in picked]


def draw_silhouettes(
    cars: Sequence[PosedCar],
    package: Path,
    out: Path,
    *,
    side: int = 320,
    progress: Progress = no_progress,
) -> list[Path]:
    """Write a grey image per photograph, NAME.png, white on the car; those that are there are left.

    Args:
        side: Side of the network's input, pixels.

    Returns:
        The files that were drawn.

    Raises:
        InvalidInputError: The npm package or a photograph cannot be read.
    """
    import onnxruntime

    out.mkdir(parents=True, exist_ok=True)
    missing = [car for car in cars if not car.silhouette(out).exists()]
    if not missing:
        return []
    session: Any = onnxruntime.InferenceSession(resized(assemble(package), side), providers=["CPUExecutionProvider"])
    name = session.get_inputs()[0].name
    for car in progress(missing, "Silhouettes"):
        image = read_image(car.image)
        small = cv2.resize(image, (side, side), interpolation=cv2.INTER_LINEAR).astype(np.float32)
        found = session.run(None, {name: ((small - _MIDDLE) / _SPREAD).transpose(2, 0, 1)[None]})[0][0, 0]
        write_bytes(car.silhouette(out), _png(cv2.resize(found, (image.shape[1], image.shape[0]))))
    return [car.silhouette(out) for car in missing]


def _png(likelihood: NDArray[np.float32]) -> bytes:
    """A grey image file of values from 0 to 1."""
    pixels = np.rint(np.clip(likelihood, 0.0, 1.0) * 255.0).astype(np.uint8)
    return bytes(cv2.imencode(".png", pixels)[1])
