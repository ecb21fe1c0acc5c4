"""Plausibility of points' unit and frame: metres, in the frame of the camera that took the image.

Points of a scan, or of a depth map, have to fall into the image, onto the ground that is given and onto the vehicles.
Where they do not, another frame or another unit is the likely cause: of all ways to exchange and reverse axes, and of
all units, the one tells which by which they do.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.camera import MIN_DEPTH, Camera, Ground
from fgrecon.core.errors import InvalidInputError

_FARTHEST = 300.0  # metres: the median depth of no scan is larger; millimetres and centimetres are
_SMALLEST = 1.0  # metres: no scan ends nearer; in kilometres, or normalised, all do
# Of `_Scene.fit`: what points that are right reach; what a mistake has to reach that explains why they do not, and how
# many times more than they do, for whole scans have strays.
_MET, _LEAST, _TIMES = np.array([0.02, 0.1, 0.01]), np.array([0.02, 0.2, 0.5]), np.array([20.0, 5.0, 20.0])
_KEPT = 0.5  # share of what fits as given, that has to fit by the mistake as well
_LOOKED_AT = 1_000  # points
_OFF_GROUND = 0.1  # share of the camera's height by which points on the ground are off it at most, beside its sigma
_MIDDLE = 0.25  # of a 2D box's sides, from its middle: pixels that are surely the vehicle's, or of what hides it
_HEIGHTS = 0.9, 4.6  # metres, of a vehicle that fills its box at the depth of its points, whatever it is;
_USUAL_HEIGHTS = 1.2, 2.4  # and of most
_FEWEST_POINTS = 5  # in the middle of a vehicle's box
_FEWEST_VEHICLES = 2  # that decide by themselves: a single one may be hidden
# What fits by a mistake counts so much where several explain it, and so much likelier are some that explain as much.
_COUNTS, _KNOWN_FRAME, _MIRRORED, _OTHER_UNIT = np.array([1.0, 1.0, 4.0]), 1.5, 0.9, 0.5
_UNITS = {"": 1.0, "millimetres": 1e-3, "centimetres": 1e-2, "feet": 0.3048}
_CAMERA = "right", "down", "forward"
_WAYS = ("right", "left"), ("down", "up"), ("forward", "backward")  # along the camera's axes
_KNOWN = {
    ("forward", "left", "up"): "a LiDAR's frame",
    ("right", "up", "backward"): "OpenGL's frame",
    ("forward", "right", "up"): "CARLA's and Unreal's frame",
    ("right", "up", "forward"): "Unity's frame",
}
_TURNS = [
    np.eye(3)[list(order)] * np.array(signs)[:, None]
    for order in permutations(range(3))
    for signs in product((1.0, -1.0), repeat=3)
]
"""(3, 3) each, from all frames along the camera's axes to its own; mirrored ones as well."""


def in_image(points: Array, camera: Camera) -> NDArray[np.bool_]:
    """(N,) which of the points (N, 3) in the camera's frame fall into its image; without its size, lie before it."""
    before: NDArray[np.bool_] = points[:, 2] > MIN_DEPTH
    if camera.image_size is None:
        return before
    pixels = np.full((len(points), 2), np.nan)
    pixels[before] = camera.project(points[before])
    inside: NDArray[np.bool_] = before.copy()
    inside[before] = np.all((pixels[before] >= -0.5) & (pixels[before] < np.array(camera.image_size) - 0.5), axis=1)
    return inside


def check_points(
    points: Array, camera: Camera, field: str = "points", ground: Ground | None = None, boxes: Sequence[Array] = ()
) -> None:
    """Refuse points that fit neither image, ground nor vehicles though they would in another frame or unit.

    Args:
        points: (N, 3) in the camera's frame, metres.
        camera: The camera; without the size of its image points count that lie before it.
        field: What an error calls them.
        ground: The ground that is given, or None.
        boxes: (4,) 2D box of each vehicle.

    Raises:
        InvalidInputError: None falls into the image, they are in another unit, or a mistake explains why they do not
            fit; says the likely cause.
    """
    some = points[:: max(1, len(points) // _LOOKED_AT)]
    inside = in_image(some, camera)
    if not inside.any() and len(some) < len(points):
        some, inside = points, in_image(points, camera)
    sure = ground is not None and not ground.is_vague and len(boxes) > 0
    scene = _Scene(camera, ground if sure else None, boxes)
    given = scene.fit(some, some, _HEIGHTS)[0]
    if not scene.is_met(given):
        given = scene.fit(some, points, _HEIGHTS)[0]
    likely = "" if scene.is_met(given) else scene.mistake(some, points, given)
    if likely or not inside.any():
        count = "hardly any" if inside.any() else "none"
        what = f"{count} of them in the image" if inside.mean() < _MET[0] else "not where ground and vehicles are"
        raise InvalidInputError(field, f"{len(points)} points, {what}", _fix(some, likely))
    median = float(np.median(some[inside, 2]))
    if median > _FARTHEST:
        unit = "millimetres" if median > 10.0 * _FARTHEST else "centimetres"
        fix = f"Give metres; these look like {unit}."
        raise InvalidInputError(field, f"a median depth of {median:.0f} m", fix)


@dataclass(frozen=True)
class _Scene:
    """What is known of where points can be."""

    camera: Camera
    ground: Ground | None
    boxes: Sequence[Array]  # (4,) of each vehicle

    def fit(self, some: Array, points: Array, heights: tuple[float, float], units: Iterable[float] = (1.0,)) -> Array:
        """(U, 3) share of points in the image, share of those that are on the ground, and of the vehicles with points.

        Args:
            some: (M, 3) a few of the points.
            points: (N, 3) all of them.
            heights: From which to which vehicles are high, metres.
            units: (U,) what the points' unit may be, metres.
        """
        inside, of_vehicles = in_image(some, self.camera), self._of_vehicles(points)
        shown, found = some[inside], list[tuple[float, float, float]]()
        for unit in units:
            met = [self._are_of(own * unit, high, heights) for own, high in of_vehicles]
            ground = self._on_ground(shown * unit).mean() if len(shown) else 0.0
            found.append((inside.mean(), ground, sum(met) / max(len(met), 1)))
        return np.array(found)

    def _on_ground(self, points: Array) -> NDArray[np.bool_]:
        """(N,) which of points (N, 3) are on the ground; none where it is not known."""
        if self.ground is None:
            return np.zeros(len(points), dtype=bool)
        near = _OFF_GROUND * self.ground.distance + self.ground.height_sigma
        return np.asarray(np.abs(points @ self.ground.normal - self.ground.distance) < near)

    def _of_vehicles(self, points: Array) -> list[tuple[Array, float]]:
        """Those of points (N, 3) in the middle of each vehicle's box, and how high it is for each metre of depth."""
        if not len(self.boxes):
            return []
        before, found = points[points[:, 2] > MIN_DEPTH], list[tuple[Array, float]]()
        column, row = self.camera.project(before).T
        for left, top, right, bottom in self.boxes:
            across, down = _MIDDLE * (right - left), _MIDDLE * (bottom - top)
            at = (np.abs(column - (left + right) / 2.0) < across) & (np.abs(row - (top + bottom) / 2.0) < down)
            found.append((before[at], float((bottom - top) / self.camera.matrix[1, 1])))
        return found

    def _are_of(self, points: Array, high: float, heights: tuple[float, float]) -> bool:
        """Whether points (M, 3) are a vehicle's that is so high for each metre of depth."""
        found = points[:, 2] * high
        on = (found > heights[0]) & (found < heights[1]) & ~self._on_ground(points)
        return int(on.sum()) >= _FEWEST_POINTS

    def is_met(self, fit: Array) -> bool:
        """Whether points with a fit (3,) are where they can be, as far as anything says so."""
        return bool((fit >= _MET)[[True, self.ground is not None, len(self.boxes) > 0]].all())

    def mistake(self, some: Array, points: Array, given: Array) -> str:
        """The frame and unit in which points fit that do not as they are given (3,); empty where there is none."""
        best, likely = 0.0, ""
        decides = np.array([True, True, len(self.boxes) >= _FEWEST_VEHICLES])
        for turn in _TURNS:
            turned = some @ turn.T
            if in_image(turned, self.camera).mean() < max(_LEAST[0], _KEPT * given[0]):
                continue
            fits = self.fit(turned, points @ turn.T, _USUAL_HEIGHTS, _UNITS.values())
            for unit, fit in zip(_UNITS, fits, strict=True):
                explains = (decides & (fit > _LEAST) & (fit > _TIMES * given)).any() and (fit >= _KEPT * given).all()
                # Points in the image that show neither ground nor vehicles, as few do, fit many ways somewhere.
                explains = explains and (given[0] < _MET[0] or self.is_met(fit))
                score = float(fit @ _COUNTS) * (_KNOWN_FRAME if _ways(turn) in _KNOWN else 1.0)
                score *= (_MIRRORED if np.linalg.det(turn) < 0.0 else 1.0) * (_OTHER_UNIT if unit else 1.0)
                if explains and score > best:
                    best, likely = score, _in_words(turn, unit)
        return likely


def _ways(turn: Array) -> tuple[str, ...]:
    """Where the axes of a frame lead that is turned so."""
    return tuple(_WAYS[int(np.abs(axis).argmax())][int(axis.sum() < 0.0)] for axis in turn.T)


def _in_words(turn: Array, unit: str) -> str:
    """A frame, and a unit that is empty where it is metres."""
    ways = _ways(turn)
    if ways == _CAMERA:
        return unit
    axes = "x {}, y {}, z {}".format(*ways)
    mirrored = "mirrored, " if np.linalg.det(turn) < 0.0 else ""
    frame = f"{_KNOWN[ways]} ({mirrored}{axes})" if ways in _KNOWN else f"a frame with {mirrored}{axes}"
    return f"{frame}, in {unit}" if unit else frame


def _fix(points: Array, likely: str) -> str:
    """What to give instead of points (N, 3) that do not fit."""
    fix = "Give points in the camera's frame (x right, y down, z forward)"
    if likely:
        return f"{fix}, in metres; these look like {likely}."
    if np.abs(points).max() < _SMALLEST:
        return f"{fix}, in metres: all of these are within {_SMALLEST:g} m."
    if (points[:, 2] <= MIN_DEPTH).all():
        return f"{fix}; all of these are behind it: the motion into its frame may be the inverse one."
    return f"{fix}, and the camera of this image: these are of another place, frame or image."
