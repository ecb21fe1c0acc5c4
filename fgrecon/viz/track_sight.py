"""What the recording of a track shows beside its result: photographs, keypoints, cameras and truth, image by image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.observation import Observation
from fgrecon.core.track_reconstruction import TrackReconstruction
from fgrecon.viz.geometry import image_points
from fgrecon.viz.truth import Truth

__all__ = ["TrackSight", "image_reach"]


@dataclass(frozen=True)
class TrackSight:
    """What a track was reconstructed from, one entry per image; images that were refused included.

    Attributes:
        observations: Its keypoints in each image; None where there are none.
        cameras: The camera of each image.
        numbers: Number of each image on the timeline `frame`, increasing; None counts them from 0.
        images: (H, W, 3) RGB photographs; None for none.
        truths: What is known to be true; None for nothing.
        ground: The ground plane that was assumed, or None.
    """

    observations: Sequence[Observation | None]
    cameras: Sequence[Camera]
    numbers: Sequence[int] | None = None
    images: Sequence[NDArray[np.uint8] | None] | None = None
    truths: Sequence[Truth | None] | None = None
    ground: Ground | None = None

    def __post_init__(self) -> None:
        """Check that there is one entry per image.

        Raises:
            InvalidInputError: A sequence has another length, or the numbers do not increase.
        """
        count = len(self.observations)
        for field in ("cameras", "numbers", "images", "truths"):
            given = getattr(self, field)
            if given is not None and len(given) != count:
                raise InvalidInputError(field, f"{len(given)} entries", f"Give one for each of {count} images.")
        if self.numbers is not None and (np.diff(np.array(self.numbers)) <= 0).any():
            raise InvalidInputError("numbers", list(self.numbers), "Give numbers that increase.")

    def number(self, index: int) -> int:
        """Number of an image on the timeline `frame`."""
        return index if self.numbers is None else int(self.numbers[index])


def image_reach(track: TrackReconstruction, sight: TrackSight) -> NDArray[np.float64]:
    """(2, 2) smallest and largest pixel of all boxes, keypoints and wireframes."""
    points = [np.zeros((0, 2))]
    for index, result in zip(track.numbers, track.frames, strict=True):
        observation = sight.observations[index]
        assert observation is not None
        points.append(observation.keypoints[observation.measured])
        if observation.box is not None:
            points.append(observation.box.reshape(2, 2))
        else:
            points.append(image_points(sight.cameras[index], result.camera_T_object, result.wireframe))
    found = np.concatenate(points)
    found = found[np.isfinite(found).all(axis=1)]
    return np.array([found.min(axis=0), found.max(axis=0)])
