"""ApolloCar3D: keypoints marked by people on cars of known pose and known model.

The file holds, for each image, cars with 66 marks (u, v, marked), a box (x, y, width, height), a pose and the number of
the car's model. Ten of our keypoints are points of that scheme or, for lamps, the centre of four of them; mirrors are
not marked. A pose (a, b, c, t) means X_camera = Rz(c) Ry(b) Rx(a) (left, up, forward) + t with its origin above the
ground, by a height that is one number per model and is fitted here. Four models are larger than the real cars; poses
were labelled with them as they are, which the marks confirm (8 to 12 cm from them, against 13 to 15 cm with the models
brought to their real size), so here they keep that size.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera
from fgrecon.core.category import Category
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import MIRROR, pixel_jacobian, rigid, transform
from fgrecon.core.observation import Observation
from fgrecon.io.json_fields import Fields, read_fields
from fgrecon_research.io.annotations.offsets import robust_offset
from fgrecon_research.training.priors.apollo79 import Apollo79

FEWEST_MARKS = 5
"""Cars with fewer of our keypoints marked are left out, and counted."""

CONSISTENT = 0.2
"""Cars whose marks lie farther than this from the labelled model at the labelled pose, median in metres at the car's
distance, are left out, and counted: their labels do not agree with one another."""

_POINTS = {0: 7, 1: 50, 2: 20, 3: 37, 10: 8, 11: 49, 12: 24, 13: 33}
_LAMPS = {4: (0, 1, 2, 3), 5: (54, 55, 56, 57), 6: (22, 23, 25, 26), 7: (31, 32, 34, 35)}
_MARKS = 66
_IMAGE_SIZE = (3384, 2710)
_HEIGHTS = np.arange(0.4, 1.5, 0.01)
_ENOUGH, _MARK_SIGMA, _WEAK = 20, 0.05, 1e-3  # of the marks' offsets; metres
_OUTLIER = 0.3  # metres; marks farther off do not say more about an origin's height
_FROM_OBJECT = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])  # (left, up, forward) of (x, y, z)


@dataclass(frozen=True)
class MarkedCar:
    """One car with known pose and shape."""

    name: str  # `<image>:<position in the image>`
    model: str  # name of its model
    keypoints: Array  # (14, 2) marks in pixels, NaN where there is none
    box: Array  # (4,) x1, y1, x2, y2
    camera_T_object: Array  # (4, 4) true pose, origin on the ground
    shape: Array  # (14, 3) true keypoints, object frame, metres
    size: Array  # (3,) true length, width and height, metres
    inconsistency: float  # median distance of the marks from the true keypoints, metres at their distance
    all_marks: Array  # (66, 2) marks in the order of `apollo66`, NaN where there is none

    @property
    def marks(self) -> int:
        """Number of marked keypoints."""
        return int(np.isfinite(self.keypoints[:, 0]).sum())

    @property
    def observation(self) -> Observation:
        """The marks, all of them sure, in the box."""
        return Observation(self.keypoints, np.isfinite(self.keypoints[:, 0]).astype(np.float64), self.box)

    @property
    def in_camera(self) -> Array:
        """(14, 3) true keypoints in the camera frame, metres."""
        return transform(self.camera_T_object, self.shape)

    @property
    def extent(self) -> float:
        """Longer side of the box, pixels."""
        return float(max(self.box[2] - self.box[0], self.box[3] - self.box[1]))

    @property
    def distance(self) -> float:
        """Distance from the camera, metres."""
        return float(np.linalg.norm(self.camera_T_object[:3, 3]))


@dataclass(frozen=True)
class MarkedCars:
    """The cars that can be scored, and how many cannot."""

    camera: Camera
    cars: tuple[MarkedCar, ...]  # cars with enough marks and consistent labels
    total: int  # number of cars in the file
    too_few: int  # cars with fewer than `FEWEST_MARKS` marks
    inconsistent: tuple[str, ...]  # names of cars whose labels disagree
    noise: float  # standard deviation of a mark per axis relative to the box's longer side, robust (from the median)


def read_apollocar3d(path: Path, models: Apollo79) -> MarkedCars:
    """Read the annotations and fit the height of each model's origin.

    Args:
        models: The 79 models; a car's `cad_id` is their index.

    Raises:
        InvalidInputError: The file cannot be read, or a field is missing or unusable.
    """
    fields = read_fields(path)
    camera = Camera(fields.numbers("camera_intrinsic", (3, 3)), image_size=_IMAGE_SIZE)
    raw = [
        _read_car(Fields(car, f"{path}: image {image['image_id']}, car {i}: "), f"{image['image_id']}:{i}", models)
        for image in fields.get("images", list)
        for i, car in enumerate(image["cars"])
    ]
    heights = _origin_heights(raw, camera)
    enough = [_lowered(car, heights[car.model], camera) for car in raw if car.marks >= FEWEST_MARKS]
    kept = tuple(car for car in enough if car.inconsistency <= CONSISTENT)
    errors = [(camera.project(car.in_camera) - car.keypoints) / car.extent for car in kept]
    return MarkedCars(
        camera=camera,
        cars=kept,
        total=len(raw),
        too_few=len(raw) - len(enough),
        inconsistent=tuple(car.name for car in enough if not car.inconsistency <= CONSISTENT),
        noise=1.4826 * float(np.nanmedian(np.abs(errors))) if errors else float("nan"),
    )


def image_half(name: str) -> int:
    """0 or 1: the half of the images that a car (`MarkedCar.name`) is of, by a hash of the image's name."""
    return hashlib.sha256(name.partition(":")[0].encode()).digest()[0] % 2


def marking_offsets(cars: Sequence[MarkedCar], camera: Camera, category: Category) -> Array:
    """Where the people who marked the cars put each keypoint, relative to where the models have it.

    Robust least squares over the marks of all cars at their labelled poses, the same for a keypoint and, mirrored, for
    its mirror image. Over all cars, roof corners are marked 2 to 5 cm forward, 2 cm higher and 4 cm further inboard.

    Returns:
        (14, 3) offsets in the object frame, metres; zero for a keypoint with fewer than `_ENOUGH` marks.
    """
    offsets = np.zeros((category.size, 3))
    for keypoint, mirrored in enumerate(category.mirror.tolist()):
        if keypoint > mirrored:
            continue
        rows = [
            row
            for car in cars
            for point, side in ((keypoint, 1.0), (mirrored, -1.0))
            if (row := _mark_residual(car, point, side, camera)) is not None
        ]
        if len(rows) >= _ENOUGH:
            jacobian, residual = np.array([j for j, _ in rows]), np.array([r for _, r in rows])
            offset = robust_offset(jacobian, residual, np.ones(len(rows)), _MARK_SIGMA, _WEAK)
            offsets[keypoint], offsets[mirrored] = offset, offset * MIRROR
    return offsets


def _mark_residual(car: MarkedCar, keypoint: int, side: float, camera: Camera) -> tuple[Array, Array] | None:
    """Derivative (2, 3) of a mark by the offset, and the mark's residual (2,), both in metres at its depth."""
    if np.isnan(car.keypoints[keypoint, 0]):
        return None
    point, focal = car.in_camera[keypoint], camera.matrix[0, 0]
    jacobian = pixel_jacobian(camera.matrix, point[None])[0] @ car.camera_T_object[:3, :3]
    scale = point[2] / focal
    return scale * jacobian * [1.0, 1.0, side], scale * (car.keypoints[keypoint] - camera.project(point))


def _read_car(fields: Fields, name: str, models: Apollo79) -> MarkedCar:
    number = fields.get("cad_id", int)
    if not 0 <= number < len(models.names):
        raise InvalidInputError(f"{name}: cad_id", number, f"Give a number from 0 to {len(models.names) - 1}.")
    marks = fields.numbers("keypoints66", (_MARKS, 3))
    x, y, width, height = fields.numbers("box", (4,))
    pose = fields.numbers("pose", (6,))
    camera_T_object = rigid(_rotation(*pose[:3]) @ _FROM_OBJECT, pose[3:])
    scale = models.scale[number]
    return MarkedCar(
        name=name,
        model=models.names[number],
        keypoints=_marked(marks),
        box=np.array([x, y, x + width, y + height]),
        camera_T_object=camera_T_object,
        shape=models.keypoints[number] / scale,
        size=models.size[number] / scale,
        inconsistency=float("nan"),
        all_marks=np.where(marks[:, 2:] > 0, marks[:, :2], np.nan),
    )


def _marked(marks: Array) -> Array:
    """(14, 2) our keypoints among the 66; a lamp only where all four of its points are marked."""
    pixels, measured = marks[:, :2], marks[:, 2] > 0
    found = np.full((14, 2), np.nan)
    groups: Mapping[int, Sequence[int]] = {**{k: (point,) for k, point in _POINTS.items()}, **_LAMPS}
    for keypoint, points in groups.items():
        if measured[list(points)].all():
            found[keypoint] = pixels[list(points)].mean(axis=0)
    return found


def _rotation(a: float, b: float, c: float) -> Array:
    """Rz(c) Ry(b) Rx(a)."""
    (sa, sb, sc), (ca, cb, cc) = np.sin([a, b, c]), np.cos([a, b, c])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, ca, -sa], [0.0, sa, ca]])
    about_y = np.array([[cb, 0.0, sb], [0.0, 1.0, 0.0], [-sb, 0.0, cb]])
    about_z = np.array([[cc, -sc, 0.0], [sc, cc, 0.0], [0.0, 0.0, 1.0]])
    return about_z @ about_y @ about_x


def _metres_off(car: MarkedCar, camera: Camera, heights: Array) -> Array:
    """(H, 14) distance of each mark from the labelled keypoint, metres at its depth; NaN where there is none."""
    rotation, origin = car.camera_T_object[:3, :3], car.camera_T_object[:3, 3]
    points = car.shape @ rotation.T + origin + heights[:, None, None] * rotation[:, 1]
    pixels = np.linalg.norm(camera.project(points) - car.keypoints, axis=2)
    return pixels * points[..., 2] / camera.matrix[0, 0]


def _lowered(car: MarkedCar, height: float, camera: Camera) -> MarkedCar:
    """The car with its origin moved down by a height, metres, and its inconsistency there."""
    pose = car.camera_T_object.copy()
    pose[:3, 3] += height * pose[:3, 1]
    moved = replace(car, camera_T_object=pose)
    return replace(moved, inconsistency=float(np.nanmedian(_metres_off(moved, camera, np.zeros(1)))))


def _origin_heights(cars: Sequence[MarkedCar], camera: Camera) -> dict[str, float]:
    """Height of the labels' origin above the ground by model: where the marks agree best with it."""
    heights: dict[str, float] = {}
    for model in sorted({car.model for car in cars}):
        off = [np.minimum(_metres_off(car, camera, _HEIGHTS), _OUTLIER) for car in cars if car.model == model]
        cost = np.nansum(np.concatenate(off, axis=1), axis=1)
        heights[model] = float(_HEIGHTS[int(cost.argmin())])
    return heights
