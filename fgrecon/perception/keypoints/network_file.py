"""The network's weights as a safetensors file: half precision, with sizes and calibration beside them."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.files import check_hash, write_bytes
from fgrecon.perception.keypoints.decode import ConfidenceCalibration

FORMAT = "fgrecon.keypoints/1"

_NAME = "keypoints-car14"

WITHOUT_STREET = "photographs"
"""Name of the shipped network that has learnt from photographs alone, and from no image of KITTI."""
_CATEGORY = "car14"  # of files that do not say
_KNET, _REFINEMENT = "knet.", "refine."
_LARGEST_SIZE = 4096  # channels, pixels, keypoints
_OTHER = "Give a network of this version."


@dataclass(frozen=True)
class Stored:
    """A network as it is kept."""

    state: Mapping[str, Any]  # arrays by name, or tensors
    settings: Mapping[str, int]  # sizes of the network
    calibration: ConfidenceCalibration  # from its outputs to confidences
    provenance: Mapping[str, str]  # learnt from what (plain strings)
    refinement: Mapping[str, Any] | None = None  # the same of the refinement networks, or None without them
    refine_settings: Mapping[str, int] | None = None  # their sizes, or None
    trust: float = 0.5  # how much their likelihoods count beside KNet's
    category: str = _CATEGORY  # name of the category whose keypoints it finds


def shipped(name: str | None = None) -> Path:
    """A file that comes with the package.

    Args:
        name: `WITHOUT_STREET`, or None for the network that is used where none is named.

    Raises:
        InvalidInputError: This installation has none.
    """
    file = f"{_NAME}.safetensors" if name is None else f"{_NAME}-{name}.safetensors"
    path = Path(str(resources.files("fgrecon") / "data" / "weights" / file))
    if not path.is_file():
        fix = "Train a network with `fgrecon keypoints train` and give its file, or give the keypoints yourself."
        raise InvalidInputError("weights", f"this installation has no {file}", fix)
    return path


def save_weights(path: Path, stored: Stored) -> Path:
    """Write a network; numbers become half precision (the loss in accuracy is far below a pixel).

    The same network gives the same bytes.
    """
    from safetensors.numpy import save

    tensors = {}
    parts = {_KNET: stored.state, _REFINEMENT: stored.refinement or {}}
    for name, value in ((part + name, value) for part, state in parts.items() for name, value in state.items()):
        array = np.asarray(value.detach().cpu() if hasattr(value, "detach") else value)
        if array.dtype.kind == "f":
            array = np.clip(array, -6e4, 6e4).astype(np.float16)
        if not name.endswith("num_batches_tracked"):
            tensors[name] = np.ascontiguousarray(array)
    about = {
        "format": FORMAT,
        "category": stored.category,
        "settings": json.dumps(dict(stored.settings)),
        "calibration": json.dumps(stored.calibration.to_dict()),
        "provenance": json.dumps(dict(stored.provenance)),
        "refinement": json.dumps(stored.refine_settings and dict(stored.refine_settings)),
        "trust": json.dumps(stored.trust),
    }
    return write_bytes(path, _in_order(save(tensors, about)))


def _in_order(content: bytes) -> bytes:
    """The same safetensors file with its metadata in the order of their names: the library has them in any order."""
    length = 8 + int.from_bytes(content[:8], "little")
    header = json.loads(content[8:length])
    header["__metadata__"] = dict(sorted(header["__metadata__"].items()))
    text = json.dumps(header, separators=(",", ":"), ensure_ascii=False).encode()
    text += b" " * (-len(text) % 8)  # the tensors begin at a multiple of eight bytes
    return len(text).to_bytes(8, "little") + text + content[length:]


def load_weights(path: Path) -> Stored:
    """Read a network, in arrays of single precision; one that comes with the package must be what it was.

    Raises:
        InvalidInputError: The file cannot be read or is no network of ours, or has been changed.
    """
    from safetensors import SafetensorError, safe_open

    fix = "Give a file that `fgrecon keypoints train` wrote."
    try:
        check_hash(path, path.read_bytes())
        with safe_open(str(path), framework="np") as file:
            about = file.metadata() or {}
            if about.get("format") != FORMAT:
                raise InvalidInputError("weights", str(path), fix)
            tensors = {name: _single(name, file.get_tensor(name)) for name in file.keys()}  # noqa: SIM118
        state, refinement = (
            {name.removeprefix(part): value for name, value in tensors.items() if name.startswith(part)}
            for part in (_KNET, _REFINEMENT)
        )
        refine = json.loads(about["refinement"])
        return Stored(
            state,
            _sizes("settings", json.loads(about["settings"])),
            _finite(ConfidenceCalibration.from_dict(json.loads(about["calibration"]))),
            _texts(json.loads(about["provenance"])),
            refinement or None,
            None if refine is None else _sizes("refinement", refine),
            _share(json.loads(about["trust"])),
            about.get("category", _CATEGORY),
        )
    except InvalidInputError:
        raise
    except (SafetensorError, OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise InvalidInputError("weights", str(path), f"{fix} The reason: {error}") from error


def check_arrays(arrays: Mapping[str, NDArray[Any]], shapes: Mapping[str, tuple[int, ...]], path: Path) -> None:
    """Refuse arrays that are not a network's."""
    missing = next((name for name in shapes if name not in arrays), None)
    if missing is not None:
        raise InvalidInputError("weights", f"no {missing} in {path}", _OTHER)
    for name, array in arrays.items():
        if name not in shapes:
            raise InvalidInputError("weights", f"an unknown {name} in {path}", _OTHER)
        if array.shape != shapes[name]:
            value = f"{name} of size {array.shape}, not {shapes[name]}, in {path}"
            raise InvalidInputError("weights", value, _OTHER)
        if not np.isfinite(array).all():
            raise InvalidInputError("weights", f"{name} that is not finite in {path}", _OTHER)


def _single(name: str, array: NDArray[Any]) -> NDArray[np.float32]:
    if array.dtype.kind not in "fiub":
        raise ValueError(f"{name} has numbers of the kind {array.dtype}")
    with np.errstate(over="ignore"):  # what becomes infinite is refused with its network
        return array.astype(np.float32)


def _sizes(name: str, value: Any) -> dict[str, int]:
    if not isinstance(value, dict) or not all(type(v) is int and 0 < v <= _LARGEST_SIZE for v in value.values()):
        raise ValueError(f"{name} {value} are no sizes")
    return value


def _finite(calibration: ConfidenceCalibration) -> ConfidenceCalibration:
    if not all(math.isfinite(value) for value in calibration.to_dict().values()):
        raise ValueError("a calibration with numbers that are not finite")
    return calibration


def _texts(value: Any) -> dict[str, str]:
    if not isinstance(value, dict):
        raise TypeError("a provenance that is no list of texts by name")
    return value


def _share(value: Any) -> float:
    if type(value) not in (int, float) or not 0.0 <= value <= 1.0:
        raise ValueError(f"a trust of {value!r}, which is none from 0 to 1")
    return float(value)
