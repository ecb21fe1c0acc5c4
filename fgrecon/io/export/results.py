"""The results that a JSON file holds, by name."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.brief import brief_repr
from fgrecon.core.checks import as_finite
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.reconstruction import FORMAT as ONE
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.io.json_fields import read_json

__all__ = ["NamedResult", "read_results"]

_MANY = ("fgrecon.reconstructions/1", "fgrecon.track/1")
_DEMO = "fgrecon.demo/1"


@dataclass(frozen=True)
class NamedResult:
    """One vehicle in one image.

    Attributes:
        name: Its id.
        result: The reconstruction.
        box: (4,) 2D box that it was observed in, pixels, or None.
        label_offset: (3,) where KITTI's label frame lies from the camera's (a labelled point is at X + offset), or
            None.
    """

    name: str
    result: Reconstruction
    box: NDArray[np.float64] | None = None
    label_offset: NDArray[np.float64] | None = None

    __repr__ = brief_repr

    @property
    def solved(self) -> bool:
        """Whether it has a pose."""
        return bool(np.isfinite(self.result.camera_T_object).all())


def read_results(path: str | Path) -> list[NamedResult]:
    """Read the results of a JSON file, those that were refused left out.

    Args:
        path: What `fgrecon reconstruct --json`, `fgrecon track --json` or `fgrecon demo` wrote, or a
            `Reconstruction.to_dict()`.

    Raises:
        InvalidInputError: It is none of these.
    """
    data = read_json(Path(path))
    kind = data.get("format") if isinstance(data, dict) else None
    try:
        if kind == ONE:
            return [NamedResult(Path(path).stem, Reconstruction.from_dict(data))]
        if kind == _DEMO:
            return [NamedResult("demo", Reconstruction.from_dict(data["result"]))]
        if kind in _MANY:
            return [_named(entry) for entry in data["instances"] if entry["result"] is not None]
    except InvalidInputError as error:
        raise InvalidInputError(f"{path}: {error.field}", error.value, error.fix) from error
    except (KeyError, TypeError, ValueError) as error:
        raise InvalidInputError(str(path), f"malformed: {error}", "Give the file as fgrecon wrote it.") from error
    fix = "Give what `fgrecon reconstruct --json`, `fgrecon track --json` or `fgrecon demo` wrote."
    raise InvalidInputError(f"{path}: format", kind, fix)


def _named(entry: dict[str, Any]) -> NamedResult:
    result = Reconstruction.from_dict(entry["result"])
    box, labelled = entry.get("box"), entry.get("location_in_label_frame")
    return NamedResult(
        name=str(entry["id"]),
        result=result,
        box=None if box is None else as_finite("box", box, (4,)),
        label_offset=None if labelled is None else result.location - as_finite("location", labelled, (3,)),
    )
