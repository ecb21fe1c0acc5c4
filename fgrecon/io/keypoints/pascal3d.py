"""Objects of PASCAL3D+ annotations: one MATLAB file per image, as the data set ships them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.isolated import Isolated

_VISIBLE = 1
"""Status of an anchor: 1 visible, 2 self-occluded, 3 occluded, 4 truncated, 5 unknown."""


@dataclass(frozen=True, eq=False)
class AnchoredObject:
    """One object of a file."""

    anchors: Mapping[str, Any]  # its anchors as MATLAB has them, by name
    box: NDArray[np.float64] | None  # (4,) x1, y1, x2, y2 in 0-based pixels, or None

    def visible(self, where: str) -> dict[str, list[float]]:
        """0-based pixels of the visible anchors, by name; an error begins with a place.

        Raises:
            InvalidInputError: An anchor has no usable location; names it.
        """
        located = {name: _location(f"{where}{name}", anchor) for name, anchor in self.anchors.items()}
        return {name: pixel.tolist() for name, pixel in located.items() if np.isfinite(pixel).all()}


def read_anchors(path: Path, child: Isolated | None = None) -> list[AnchoredObject]:
    """The objects of a file with their anchors, none where an object has none.

    Args:
        child: The process to decode it in, since damaged files can kill SciPy's; None starts one.

    Raises:
        InvalidInputError: The file cannot be read, or is none of PASCAL3D+'s.
    """
    if child is not None:
        return child(str(path), _decode, path)
    with Isolated() as own:
        return own(str(path), _decode, path)


def _decode(path: Path) -> list[AnchoredObject]:
    from scipy.io import loadmat

    fix = "Give a file of PASCAL3D+'s Annotations folder (MATLAB 5 to 7.2 format)."
    try:
        record = loadmat(str(path), squeeze_me=True, struct_as_record=False)["record"]
        objects = np.atleast_1d(record.objects)
    except FileNotFoundError:
        raise InvalidInputError("annotations", str(path), "Give a file that exists.") from None
    except KeyError:
        raise InvalidInputError(f"{path}: record", "no such variable", fix) from None
    except AttributeError:
        raise InvalidInputError(f"{path}: record.objects", "no such field", fix) from None
    except Exception as error:  # SciPy promises no kind of error for damaged content
        raise InvalidInputError(str(path), f"not readable: {error}", fix) from error
    return [AnchoredObject(_anchors(item), _box(item)) for item in objects]


def _anchors(item: Any) -> dict[str, Any]:
    group = getattr(item, "anchors", None)
    return {name: getattr(group, name) for name in getattr(group, "_fieldnames", [])}


def _box(item: Any) -> NDArray[np.float64] | None:
    """The 2D box, whose pixels MATLAB counts from 1."""
    box = np.asarray(getattr(item, "bbox", ()))
    if box.size != 4 or box.dtype.kind not in "iuf" or not np.isfinite(box).all():
        return None
    return box.astype(np.float64).ravel() - 1.0


def _location(where: str, anchor: Any) -> NDArray[np.float64]:
    """(2,) 0-based pixels, NaN where the anchor is not visible."""
    status = getattr(anchor, "status", None)
    if status is None and not hasattr(anchor, "location"):
        raise InvalidInputError(where, repr(anchor), "Give an anchor with status and location.")
    location = np.asarray(getattr(anchor, "location", ()))
    if status is not None and (np.size(status) != 1 or int(np.ravel(status)[0]) != _VISIBLE):
        return np.full(2, np.nan)
    if location.size == 0 and status is None:
        return np.full(2, np.nan)
    if location.size != 2 or location.dtype.kind not in "iuf" or not np.isfinite(location).all():
        raise InvalidInputError(where, location.tolist(), "Give a visible anchor a location [x y].")
    return location.astype(np.float64).ravel() - 1.0
