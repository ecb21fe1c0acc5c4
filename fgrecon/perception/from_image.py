"""From detected keypoints to pose and shape, with the network's idea of the direction as a prior.

Keypoints of a car seen from ahead and of one seen from behind can look much alike: both poses are minima of the pose
stage's energy, and the wrong one may be a few nats lower. The network says from which direction it thinks that it sees
the car; minus the logarithm of that probability is added to the energy of every pose that the search ended in, and
where another one wins, the car is solved again from there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import FgreconError
from fgrecon.core.options import Options
from fgrecon.core.reconstruction import Reconstruction, rotation_y
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SizePrior
from fgrecon.perception.keypoints.detect import Detection, Detector
from fgrecon.solve.pipeline import reconstruct

__all__ = ["FromImage", "direction_penalty", "reconstruct_detection", "reconstruct_image"]

Array = NDArray[np.float64]

_DOUBT = 0.05
"""Probability that the network's direction means nothing: no direction costs more than its logarithm and a little."""


@dataclass(frozen=True)
class FromImage:
    """One vehicle of an image.

    Attributes:
        detection: What the network found.
        result: The reconstruction, or None where it was refused.
        error: With which error it was refused, or None.
    """

    detection: Detection
    result: Reconstruction | None
    error: FgreconError | None


def direction_penalty(detection: Detection, camera_T_object: ArrayLike) -> float:
    """What a pose costs by the network's directions, nats: 0 for the most probable one."""
    pose = np.asarray(camera_T_object, dtype=np.float64)
    x, _, z = -pose[:3, :3].T @ pose[:3, 3]
    bins = len(detection.azimuth)
    place = float(np.arctan2(z, x)) % (2.0 * np.pi) / (2.0 * np.pi) * bins
    low, share = int(place) % bins, place % 1.0
    probability = (1.0 - _DOUBT) * detection.azimuth + _DOUBT / bins
    here = (1.0 - share) * probability[low] + share * probability[(low + 1) % bins]
    return float(np.log(probability.max() / here))


def reconstruct_detection(
    detection: Detection, camera: Camera, *, options: Options | None = None, **arguments: Any
) -> Reconstruction:
    """Pose and shape of a detected vehicle.

    Args:
        detection: What the network found.
        camera: The camera that took the image.
        options: Settings.
        arguments: Further ones of `fgrecon.reconstruct`: prior, ground, size_prior.

    Raises:
        InvalidInputError: An argument cannot be used.
        DegenerateProblemError: The keypoints do not determine a pose.
    """
    first = reconstruct(detection.observation, camera, options=options, **arguments)
    here = direction_penalty(detection, first.camera_T_object)
    other = [(a.excess + direction_penalty(detection, a.camera_T_object), a) for a in first.alternatives]
    better = min((pair for pair in other if pair[0] < here), key=lambda pair: pair[0], default=None)
    if better is None:
        return first
    turn = rotation_y(better[1].camera_T_object)
    second = reconstruct(detection.observation, camera, options=options, **{**arguments, "initial": turn})
    return second if direction_penalty(detection, second.camera_T_object) < here else first


def reconstruct_image(
    image: NDArray[Any],
    boxes: ArrayLike,
    camera: Camera,
    *,
    detector: Detector | None = None,
    prior: ShapePrior | str = "car14",
    ground: Ground | None = None,
    size_prior: SizePrior | str | None = None,
    options: Options | None = None,
) -> list[FromImage]:
    """Pose and shape of the vehicles in an image. All boxes pass through the network in one batch.

    Args:
        image: (H, W, 3) RGB, or grey; 8 or 16 bits.
        boxes: (N, 4) x1, y1, x2, y2 in pixels.
        camera: The camera that took it.
        detector: The networks; None for those of the package.
        prior: Shape prior or its name.
        ground: Ground plane, or None.
        size_prior: Fleet, or None.
        options: Settings.

    Raises:
        InvalidInputError: The image or a box cannot be used.
    """
    found: Sequence[Detection] = (Detector() if detector is None else detector)(image, boxes)
    height, width = np.shape(image)[:2]
    sized = camera if camera.image_size is not None else replace(camera, image_size=(width, height))
    vehicles = []
    for detection in found:
        try:
            result = reconstruct_detection(
                detection, sized, options=options, prior=prior, ground=ground, size_prior=size_prior
            )
            vehicles.append(FromImage(detection, result, None))
        except FgreconError as error:
            vehicles.append(FromImage(detection, None, error))
    return vehicles
