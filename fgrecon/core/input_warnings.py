"""Implausible inputs: what must be wrong about one vehicle, and the warnings for many.

Such keypoints and cameras are solved nevertheless, since each of these can be right in an odd case; but the status of a
result alone does not tell what to look for. The entries of Python warn (`warn_of`), each time that they are called;
what calls them for many vehicles says it once, with their number (`summed_up`).
"""

from __future__ import annotations

import math
import warnings
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from enum import StrEnum
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera
from fgrecon.core.errors import ContradictoryInputWarning, InvalidInputError
from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import Reconstruction


@dataclass(frozen=True)
class InputWarningSettings:
    """From which on an input must be wrong. Where nothing else is said a number was not tuned."""

    farthest_outside: float = 0.5  # of an image's size: so far beyond its edges are keypoints of a vehicle it cuts off
    farthest_m: float = 2000.0  # a camera that shows keypoints of a vehicle there sees 0.1 degree
    mirrored_gain_nats: float = 8.0
    """By which keypoints fit better with left and right exchanged if they are. Exchanged ones of KITTI's tracks gain
    11 to 40, and the right ones lose as much."""
    unmirrored_share: float = 0.6  # of keypoints that fit, from which on that is not tried; of exchanged ones half do
    beside_box: float = 0.25  # of a box's longer side: so far beside it are keypoints still its vehicle's
    image_edge: float = 0.02  # of an image's size: so near its edge ends the box of a vehicle that it cuts off
    least_certain_keypoints: int = 6  # from which on something can be said of their fit
    fitting_weight: float = 0.5  # from which a keypoint fits
    few_fitting_share: float = 0.25  # of a vehicle's keypoints
    square_difference: float = 0.1  # by which fx and fy may differ: pixels are square
    exchanged_same: float = 0.005  # so little fx and cx differ where fy and cx are exchanged
    exchanged_other: float = 0.01  # and so much fx and fy
    farthest_right: float = 2.5  # times cx: there are no keypoints of an image with its principal point in the middle
    scale_alike_log: float = 0.2  # by how much less the sides' ratios differ in an image of another size
    scale_off_log: float = 0.25  # and how far they are from 1
    widest_view_degrees: float = 140.0  # horizontal
    narrowest_view_degrees: float = 10.0  # horizontal; of photographs of cars 4 % are cut narrower
    least_strayed_keypoints: int = 5  # from which on one is judged by how far it is from the others
    stray_distance: float = 10.0  # times the median of these distances; on KITTI's tracks no keypoint has over 3.6
    widest_ray: float = 11.4  # tangent of 85 degrees beside the axis
    leaning_radians: float = math.radians(35.0)  # of results: tilt against the camera
    longest_interval_s: float = 10.0  # between frames over which vehicles are followed
    own_share: float = 0.5
    """Share of a scan's points in the middle of a 2D box that are its vehicle's: below, something hides the vehicle, or
    the scan is elsewhere, which it is where most vehicles have less. Chosen on drive 0003 of KITTI's tracking set:
    right scans, whole and thinned, leave each vehicle 0.6 or more, those 1 m sideways 0.2 in the median."""
    own_pixel_share: float = 0.2
    """The same of a depth map's pixels, of which the vehicle's may be some percent off. Chosen there too: right maps
    leave 0.7 or more, those of twice and three times the depth none."""
    least_scanned: int = 2  # vehicles from which on a scan is judged: one alone may be hidden
    above_share: float = 0.35  # of results: height over the camera by the distance


SETTINGS = InputWarningSettings()
"""What is used."""

_INTERVALS = 2  # between frames, from which on they are judged: one may be a gap
_NAMED = 3  # vehicles that a warning names
_MARKS = np.array([-999.0, -1000.0, -9999.0, 9999.0, 99999.0])  # for u and v of a point that is missing


class InputWarning(StrEnum):
    """What must be wrong with a vehicle's keypoints or its camera."""

    UNITS = "units"
    """All lie between 0 and 1."""
    BESIDE = "beside"
    """Most lie beside the 2D box."""
    BEYOND = "beyond"
    """Most lie far outside of the image."""
    PRINCIPAL_POINT = "principal_point"
    """That of the camera is outside of its image."""
    OTHER_SIZE = "other_size"
    """The camera's principal point is the middle of an image of another size."""
    SQUARE = "square"
    """The camera's pixels are far from square."""
    FIELD_OF_VIEW = "field_of_view"
    """Hardly a lens has the camera's."""
    MIRRORED = "mirrored"
    """They fit better with left and right exchanged."""
    FAR = "far"
    """The result is farther away than cameras show keypoints."""
    AIR = "air"
    """The result is in the air, or leans by tens of degrees."""
    FIT = "fit"
    """Hardly one fits the result."""
    FACTORS = "factors"
    """Factors of the caller's own contradict the image."""
    RANGE = "range"
    """A range contradicts the image."""
    POINTS = "points"
    """Measured points contradict the image."""
    DEPTH = "depth"
    """By a depth map it is where it is not."""


_ELSEWHERE = {
    "points": "The scan is not where the image shows the vehicles: in the middle of most 2D boxes less than half of "
    "its points are the vehicle's. Is the sensor's pose right (--lidar-pose, camera_T_points), and the scan of this "
    "image's time?",
    "depth": "The depth map is not where the image shows the vehicles: in the middle of most 2D boxes hardly a pixel "
    "is the vehicle's. Are its numbers metres along the camera's axis, and of this image? Else say what they are: "
    "scale, scale_and_shift, inverse.",
}

_SENTENCES = {
    "units": "All keypoints of {} are between 0 and 1, as parts of an image do. Give pixels.",
    "beside": "Most keypoints of {} are beside the 2D box. Are u and v swapped, or is the box not x1, y1, x2, y2?",
    "beyond": "Most keypoints of {} are far outside of the image, or of one with the camera's principal point in its "
    "middle. Are u and v swapped, or is it another image, or K of a smaller one?",
    "principal_point": "The principal point of the camera of {} is outside of the image. Are cx and cy exchanged, or "
    "is K of another image or unit? (Of a part of an image it may be so: Camera.cropped, --crop.)",
    "other_size": "The principal point of the camera of {} is the middle of an image of another size. Was the image "
    "made smaller or larger? K has to be as well.",
    "square": "fx and fy of the camera of {} differ as hardly a camera's do. Is their order fx, fy, cx, cy?",
    "field_of_view": f"The camera of {{}} sees more than {SETTINGS.widest_view_degrees:g} degrees or less than "
    f"{SETTINGS.narrowest_view_degrees:g}, as hardly one does. Is its focal length in pixels of this image?",
    "mirrored": "The keypoints of {} fit better with left and right exchanged. Left and right are the vehicle's own; "
    "or is the image mirrored?",
    "far": f"The results of {{}} are more than {SETTINGS.farthest_m:g} m away. Is the camera's focal length in pixels "
    "of this image?",
    "air": "The results of {} are high up in the air, or lean by tens of degrees against the camera. Are the camera's "
    "intrinsics right, and the image upright? Of a camera that looks down give the ground.",
    "fit": "Hardly a keypoint of {} fits. Is their order the category's, and are left and right the vehicle's own?",
    "factors": "Factors of yours (`extra_factors`) contradict what is known of {} without them. Are they in metres and "
    "radians, in fgrecon's frames, and of this vehicle?",
    "range": "The range of {} contradicts its image. Is it in metres, from the sensor that `origin` says, and of this "
    "vehicle?",
    "points": "Measured points put {} where its keypoints are not. Are they of this image's time, and in its camera's "
    "frame?",
    "depth": "The depth map puts {} where it is not, and is not used. Are its numbers metres along the camera's axis, "
    "and of this image? Else say what they are: scale, scale_and_shift, inverse.",
}

DEPTHS_ELSEWHERE = "depth: left out"
"""How `Diagnostics.left_out` begins to say so of a vehicle."""

FACTORS_CONTRADICT, RANGE_CONTRADICTS = "factors of yours contradict", "its range contradicts"
POINTS_CONTRADICT = "points on it contradict"
"""How a result's reason begins to say so."""

_CONTRADICTIONS = {
    FACTORS_CONTRADICT: InputWarning.FACTORS,
    RANGE_CONTRADICTS: InputWarning.RANGE,
    POINTS_CONTRADICT: InputWarning.POINTS,
}

REASONS = {
    InputWarning.PRINCIPAL_POINT: "the principal point of its camera is outside of the image",
    InputWarning.OTHER_SIZE: "the principal point of its camera is the middle of an image of another size",
    InputWarning.SQUARE: "the pixels of its camera are far from square",
    InputWarning.FIELD_OF_VIEW: "hardly a lens has the field of view of its camera",
    InputWarning.FAR: f"it is more than {SETTINGS.farthest_m:g} m away",
    InputWarning.AIR: "it is high up in the air, or leans by tens of degrees against the camera",
}
"""Of warnings of a camera: the clauses of results that are weak by it."""

_BEFORE = frozenset(
    {
        InputWarning.UNITS,
        InputWarning.BESIDE,
        InputWarning.BEYOND,
        InputWarning.PRINCIPAL_POINT,
        InputWarning.OTHER_SIZE,
        InputWarning.SQUARE,
        InputWarning.FIELD_OF_VIEW,
    }
)
"""What is warned of before a vehicle is solved, whose fit then says nothing more."""

_SUMMED_UP: ContextVar[bool] = ContextVar("summed_up", default=False)


@dataclass
class InputWarnings:
    """The warnings of any number of vehicles; keeps the first names and counts."""

    judged: int = 0  # vehicles with a result
    counts: Counter[InputWarning] = field(default_factory=Counter)  # vehicles by their warning
    names: dict[InputWarning, list[str]] = field(default_factory=dict)  # the first of these
    # the first vehicles with measured points in the middles of their 2D boxes, by what measured these
    scanned: dict[str, set[str]] = field(default_factory=dict)
    of_scans: Counter[tuple[str, bool]] = field(default_factory=Counter)  # results of such, by whether they are theirs

    @classmethod
    def of(cls, found: Mapping[str, InputWarning | None]) -> InputWarnings:
        """What was found of vehicles before they are solved, by their names."""
        warnings = cls()
        for name, warning in found.items():
            warnings.add(name, warning)
        return warnings

    def add(self, name: str, warning: InputWarning | None) -> None:
        """Count a vehicle."""
        if warning is not None:
            self.counts[warning] += 1
            first = self.names.setdefault(warning, [])
            if len(first) < _NAMED:
                first.append(name)

    def add_result(self, name: str, observed: Observation, result: Reconstruction, vehicle: str | None = None) -> None:
        """Count a result of a vehicle, whose name is that of the result where it has one alone."""
        self.judged += 1
        self.add(name, result_warning_of(observed, result))
        self.add_scanned(vehicle or name, result.diagnostics.own_shares)

    def add_scanned(self, vehicle: str, own_shares: Mapping[str, float | None]) -> None:
        """Count a result of a vehicle, if there are measured points in the middle of its 2D box."""
        for kind, least in (("points", SETTINGS.own_share), ("depth", SETTINGS.own_pixel_share)):
            if (share := own_shares.get(kind)) is not None:
                self.of_scans[kind, share >= least] += 1
                if len(some := self.scanned.setdefault(kind, set())) < SETTINGS.least_scanned:
                    some.add(vehicle)

    @property
    def scan(self) -> list[str]:
        """What to warn of scans and depth maps that are not where the vehicles are."""
        judged = [kind for kind, some in self.scanned.items() if len(some) == SETTINGS.least_scanned]
        return [_ELSEWHERE[kind] for kind in judged if self.of_scans[kind, False] > self.of_scans[kind, True]]

    def lines(self) -> list[str]:
        """What to warn of; of results where nothing else is wrong, and if it is that of most vehicles.

        Of a range if it is that of one: each is of a vehicle of its own.
        """
        shown, scan = [one for one in InputWarning if self.counts[one] and one in _BEFORE], list[str]()
        if not shown:
            most = {n for n, count in self.counts.items() if 2 * count > self.judged or n is InputWarning.RANGE}
            scan = [] if InputWarning.DEPTH in most else self.scan
            shown = [one for one in InputWarning if one in most and not (scan and one is InputWarning.POINTS)]
        return scan + [_SENTENCES[one.value].format(self._named(one)) for one in shown]

    def _named(self, warning: InputWarning) -> str:
        more = self.counts[warning] - len(self.names[warning])
        return ", ".join(self.names[warning]) + (f" and {more} more" if more else "")


@contextmanager
def summed_up() -> Iterator[None]:
    """Within it nothing is warned of: the caller says what all vehicles are warned of, at once."""
    before = _SUMMED_UP.set(True)
    try:
        yield
    finally:
        _SUMMED_UP.reset(before)


def warn_of(warnings: InputWarnings, stacklevel: int) -> None:
    """Warn a caller of Python.

    Args:
        warnings: The warnings of the vehicles of the call.
        stacklevel: Of the caller, as `warnings.warn` has it in the function that calls this one.

    Warns:
        ContradictoryInputWarning: Something is, and nobody sums up.
    """
    for line in warnings.lines():
        warn(line, stacklevel + 1)


def warn(line: str, stacklevel: int) -> None:
    """Warn a caller of Python of one thing; as `warn_of`."""
    if not _SUMMED_UP.get():
        warnings.warn(line, ContradictoryInputWarning, stacklevel=stacklevel + 1)


def input_warning_of(observation: Observation, camera: Camera) -> InputWarning | None:
    """What must be wrong with a vehicle's keypoints as they are given, or its camera, if anything.

    Of what a network detected with the vehicle's direction, whose names of keypoints are its own, only the camera is
    checked.
    """
    detected = observation.azimuth is not None
    return (None if detected else _warning_of_keypoints(observation, camera)) or camera_warning_of(camera)


@lru_cache(maxsize=64)  # many vehicles of few cameras
def camera_warning_of(camera: Camera) -> InputWarning | None:
    """What of a camera contradicts the size of its image, or itself."""
    (fx, _, cx), (_, fy, cy), _ = camera.matrix.tolist()
    if abs(fx / fy - 1.0) > SETTINGS.square_difference and abs(fy / fx - 1.0) > SETTINGS.square_difference:
        return InputWarning.SQUARE
    exchanged = abs(cx / fx - 1.0) < SETTINGS.exchanged_same and abs(fy / fx - 1.0) > SETTINGS.exchanged_other
    if camera.image_size is not None and exchanged:
        middle = camera.image_size[0] / 2.0
        if abs(fy - middle) < abs(cx - middle):  # fx, cx, fy, cy
            return InputWarning.SQUARE
    if camera.image_size is None or camera.cropped_from_larger:
        return None
    width, height = camera.image_size
    if not (-0.5 <= cx <= width - 0.5 and -0.5 <= cy <= height - 0.5):
        return InputWarning.PRINCIPAL_POINT
    across, down = math.log(max(2.0 * cx, 1.0) / width), math.log(max(2.0 * cy, 1.0) / height)
    alike, off = SETTINGS.scale_alike_log, SETTINGS.scale_off_log
    if abs(across - down) < alike and min(abs(across), abs(down)) > off:
        return InputWarning.OTHER_SIZE
    view = math.degrees(2.0 * math.atan(width / (2.0 * fx)))
    usual = SETTINGS.narrowest_view_degrees < view < SETTINGS.widest_view_degrees
    return None if camera.focal_sigma or usual else InputWarning.FIELD_OF_VIEW


def _warning_of_keypoints(observation: Observation, camera: Camera) -> InputWarning | None:
    if not observation.measured.any():
        return None
    every = observation.keypoints[observation.measured]
    if _is_usual(every, observation, camera):
        return None
    if (camera.matrix[:2, 2] > 1.0).any() and ((every >= 0.0) & (every <= 1.0)).all():
        return InputWarning.UNITS
    points = observation.keypoints[_certain(observation)]
    size = None if camera.image_size is None else np.array(camera.image_size, dtype=np.float64)
    if observation.box is not None:
        wider = SETTINGS.beside_box * observation.extent
        beside = _outside(points, observation.box[:2] - wider, observation.box[2:] + wider)
        if size is not None and _at_edge(observation.box, size):  # the vehicle goes on outside of the image
            beside &= ~_outside(points, np.zeros(2), size)
        if np.mean(beside) > 0.5:
            return InputWarning.BESIDE
    if (
        size is not None
        and np.mean(_outside(points, -SETTINGS.farthest_outside * size, (1.0 + SETTINGS.farthest_outside) * size)) > 0.5
    ):
        return InputWarning.BEYOND
    if (
        size is None
        and not camera.cropped_from_larger
        and np.mean(points[:, 0] > SETTINGS.farthest_right * camera.matrix[0, 2]) > 0.5
    ):
        return InputWarning.BEYOND
    return None


def _is_usual(points: Array, observation: Observation, camera: Camera) -> bool:
    """Whether all points (N, 2) are where those of most vehicles are, of which there is nothing to warn."""
    (left, top), (right, bottom) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    if observation.box is not None:
        wider, (x1, y1, x2, y2) = SETTINGS.beside_box * observation.extent, observation.box.tolist()
        if not (x1 - wider <= left and y1 - wider <= top and right <= x2 + wider and bottom <= y2 + wider):
            return False
    if camera.image_size is None:
        within = camera.cropped_from_larger or right <= SETTINGS.farthest_right * float(camera.matrix[0, 2])
    else:
        width, height = camera.image_size
        within = min(left, top) >= 0.0 and right <= width and bottom <= height
    return within and max(right, bottom) > 1.0


def strays(observation: Observation, camera: Camera) -> list[tuple[NDArray[np.bool_], str]]:
    """The keypoints (K,) where their vehicle cannot be, by reasons: whatever their weight, noise goes by the extent.

    These are marks of other programs for what is missing, points far outside of an image of known size, and points
    absurdly far from the others.

    Raises:
        InvalidInputError: By the intrinsics, which are of another unit, most others are where no pinhole sees.
    """
    pixels, measured = observation.keypoints, observation.measured
    marks = np.asarray((pixels[..., None] == _MARKS).any(axis=2).all(axis=1))
    found, left = [(marks, "other programs mark so what is missing")], ~marks
    if camera.image_size is not None:
        size = np.array(camera.image_size, dtype=np.float64)
        outside = left & _outside(pixels, -SETTINGS.farthest_outside * size, (1.0 + SETTINGS.farthest_outside) * size)
        if 2 * np.count_nonzero(outside) < np.count_nonzero(measured & left):  # else it is another image
            image = f"{camera.image_size[0]} x {camera.image_size[1]}"
            found, left = [*found, (outside, f"far outside of the image of {image}")], left & ~outside
    points = pixels[measured & left]
    if len(points) >= SETTINGS.least_strayed_keypoints:
        away = np.abs(pixels - _median(points)).max(axis=1)
        with np.errstate(invalid="ignore"):
            far = np.asarray(left & (away > SETTINGS.stray_distance * max(float(_median(away[measured & left])), 1.0)))
        found, left = [*found, (far, "far from all others")], left & ~far
    _check_rays(pixels[measured & left], camera)
    return found


def _median(numbers: Array) -> Array:
    """Along the first axis: of few numbers in a fraction of numpy's time."""
    ordered, half = np.sort(numbers, axis=0), len(numbers) // 2
    return ordered[half] if len(numbers) % 2 else (ordered[half - 1] + ordered[half]) / 2.0


def _check_rays(points: Array, camera: Camera) -> None:
    """Refuse intrinsics of another unit: by them most points (N, 2) are where no pinhole sees."""
    if not len(points):
        return
    aside = float(_median(np.abs((points - camera.matrix[:2, 2]) / camera.matrix.diagonal()[:2]).max(axis=1)))
    if aside > SETTINGS.widest_ray:
        degrees = np.degrees(np.arctan(aside))
        fix = "Give K in pixels of this image."
        raise InvalidInputError("intrinsics", f"keypoints {degrees:.1f} degrees beside the camera's axis", fix)


def result_warning_of(observation: Observation, result: Reconstruction) -> InputWarning | None:
    """What must be wrong with a vehicle's keypoints or its camera, if anything, by its result."""
    for said, warning in _CONTRADICTIONS.items():
        if any(reason.startswith(said) for reason in result.reasons):
            return warning
    if result.diagnostics.mirrored_gain > SETTINGS.mirrored_gain_nats:
        return InputWarning.MIRRORED
    share = fit_share(observation, result.diagnostics.weights)
    if observation.azimuth is None and share is not None and share < SETTINGS.few_fitting_share:
        return InputWarning.FIT
    if result.status.determined and np.linalg.norm(result.location) > SETTINGS.farthest_m:
        return InputWarning.FAR
    grounded = "ground" in result.diagnostics.energies  # which says how the camera looks at it
    if result.status.determined and not grounded and in_the_air(result.camera_T_object):
        return InputWarning.AIR
    if any(line.startswith(DEPTHS_ELSEWHERE) for line in result.diagnostics.left_out):
        return InputWarning.DEPTH
    return None


def in_the_air(camera_T_object: Array) -> bool:
    """Whether a vehicle at a pose (4, 4) is high up in the air, or leans by tens of degrees against the camera."""
    if not np.isfinite(camera_T_object).all():
        return False
    x, y, z = camera_T_object[:3, 3].tolist()
    return bool(
        camera_T_object[1, 1] < math.cos(SETTINGS.leaning_radians) or -y > SETTINGS.above_share * math.hypot(x, z)
    )


def fit_share(observation: Observation, weights: Array) -> float | None:
    """Share of the keypoints that fit; None where they are too few to say.

    Args:
        observation: What was observed.
        weights: (K,) of the result.
    """
    certain = _certain(observation)
    return (
        float(np.mean(weights[certain] >= SETTINGS.fitting_weight))
        if np.count_nonzero(certain) >= SETTINGS.least_certain_keypoints
        else None
    )


def interval_warning(times: Sequence[float]) -> str | None:
    """What to warn of frames at these times, seconds, over which vehicles are followed."""
    if len(times) < _INTERVALS + 1:
        return None
    usual = float(np.percentile(np.diff(times), 50.0, method="lower"))
    if usual < SETTINGS.longest_interval_s:
        return None
    return f"Frames are {usual:g} s apart, too far to follow vehicles. Are their times seconds, and is --fps right?"


def _at_edge(box: Array, size: Array) -> bool:
    """Whether a box reaches an edge of its image."""
    margin = SETTINGS.image_edge * size
    return bool((box[:2] < margin).any() or (box[2:] > size - margin).any())


def _certain(observation: Observation) -> NDArray[np.bool_]:
    """(K,) the keypoints that are as likely right as wrong, or likelier; all that are measured where none is."""
    certain: NDArray[np.bool_] = observation.measured & (observation.confidence >= observation.confidence_midpoint)
    return certain if certain.any() else observation.measured


def _outside(points: Array, least: Array, most: Array) -> NDArray[np.bool_]:
    """(N,) which points (N, 2) lie outside of a rectangle."""
    return np.any((points < least) | (points > most), axis=1)
