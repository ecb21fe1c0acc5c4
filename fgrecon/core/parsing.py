"""Parsing of options' texts: grounds, and numbers separated by commas."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from fgrecon.core.errors import InvalidInputError

if TYPE_CHECKING:  # the command line must start fast: what the commands need is imported when they run
    from fgrecon.core.camera import Ground


def parse_ground(plane: str | None, height: float | None) -> tuple[Ground, str] | None:
    """The ground plane and, in words, where it comes from; None where neither option is given.

    Args:
        plane: `nx,ny,nz,d`, or `d` alone of a camera that may be tilted.
        height: Height of a level camera, metres.

    Raises:
        InvalidInputError: Both are given, one is not a plane, or the camera would be higher than 100 metres.
    """
    from fgrecon.core.camera import Ground

    if plane is not None and height is not None:
        raise InvalidInputError("camera_height", height, "Give either --camera-height or --ground.")
    if height is not None:
        try:
            level = Ground.level(height)
        except InvalidInputError as error:
            raise InvalidInputError("camera_height", height, error.fix) from error
        return level, f"level camera {height:g} m above the ground"
    if plane is None:
        return None
    numbers = parse_numbers("ground", plane, "nx,ny,nz,d: four numbers, or d alone, the camera's height", (4, 1))
    if len(numbers) == 1:
        return Ground.of_height(numbers[0]), f"camera {numbers[0]:g} m above the ground, however tilted"
    import numpy as np

    nx, ny, nz, distance = numbers
    return Ground(np.array([nx, ny, nz]), distance).as_given(), f"plane {plane}"


def parse_numbers(field: str, text: str, expected: str, counts: tuple[int, ...]) -> list[float]:
    """Numbers separated by commas.

    Args:
        field: Name of the option, for errors.
        expected: What to give, for errors.
        counts: How many there may be.

    Raises:
        InvalidInputError: Something is not a finite number, or there are too many or too few.
    """
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in counts or not all(map(math.isfinite, numbers)):
        raise InvalidInputError(field, text, f"Give {expected}.")
    return numbers
