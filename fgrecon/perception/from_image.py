"""From an image to pose and shape: boxes, keypoints and directions by the networks, and a solve of every vehicle."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.camera import Camera, Ground
from fgrecon.core.checks import as_finite, as_flag, as_list, as_rows
from fgrecon.core.detection import Detection
from fgrecon.core.errors import AssumedCameraWarning, FgreconError, InvalidInputError
from fgrecon.core.evidence import Evidence, VehicleClass
from fgrecon.core.options import Options, checked_options
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SizesLike
from fgrecon.io.catalogue import load_prior
from fgrecon.io.images import read_photograph
from fgrecon.perception.boxes import for_detected, large_vehicles
from fgrecon.perception.keypoints.detect import as_rgb8, shipped_cascade
from fgrecon.perception.protocols import KeypointDetector, VehicleDetector, find_keypoints
from fgrecon.perception.stereo import with_depths
from fgrecon.perception.vehicles import NanodetVehicleDetector
from fgrecon.solve.pipeline import reconstruct
from fgrecon.solve.scene import reconstruct_scene

if TYPE_CHECKING:
    import gtsam


@dataclass(frozen=True, eq=False)
class FromImage:
    """One vehicle of an image.

    Attributes:
        detection: What the keypoint detector returned.
        result: The reconstruction, or None where it was refused.
        error: With which error it was refused, or None.
        camera: The camera that it was solved with; an estimated focal length has the standard deviation of its
            logarithm in `focal_sigma`.
        track: Its id by the vehicle detector, where that is a tracker; or None.
    """

    detection: Detection
    result: Reconstruction | None
    error: FgreconError | None
    camera: Camera | None = None
    track: int | None = None

    def __repr__(self) -> str:
        """A line: the box, and how it ended and where the vehicle is, or why it was refused."""
        box = self.detection.observation.box
        where = "" if box is None else f"box ({', '.join(f'{number:.0f}' for number in box)}): "
        if self.result is None:
            return f"{type(self).__name__}({where}refused, {self.error})"
        (x, y, z), yaw = self.result.location, np.degrees(self.result.rotation_y)
        pose = f"({x:.2f}, {y:.2f}, {z:.2f}) m, yaw {yaw:.1f} degrees"
        return f"{type(self).__name__}({where}{self.result.status.value} at {pose})"


def reconstruct_detection(
    detection: Detection, camera: Camera, *, options: Options | None = None, **arguments: Any
) -> Reconstruction:
    """Pose and shape of a detected vehicle.

    Args:
        detection: What a keypoint detector returned.
        camera: The camera that took the image.
        options: Settings.
        arguments: Further ones of `fgrecon.reconstruct`: prior, ground, size_prior.

    Raises:
        InvalidInputError: An argument cannot be used.
        DegenerateProblemError: The keypoints do not determine a pose.
    """
    return reconstruct(detection.evidence, camera, options=options, **arguments)


def reconstruct_detections(
    detections: Sequence[Detection],
    camera: Camera,
    *,
    prior: ShapePrior | str | Path = "car14",
    ground: Ground | float | None = None,
    size_prior: SizesLike | None = None,
    options: Options | None = None,
    together: bool = True,
    evidence: Sequence[Evidence] = (),
    extra_factors: Sequence[gtsam.NonlinearFactor] = (),
) -> list[FromImage]:
    """Pose and shape of the detected vehicles of one image; the arguments are those of `reconstruct_image`.

    Args:
        detections: What a keypoint detector returned.
        camera: The camera that took the image, which may be one of unknown focal length.
        ground: Ground plane.
        together: Whether the vehicles share one ground.
        evidence: What other sensors say of the vehicles.
        extra_factors: The caller's own factors.

    Returns:
        The vehicles, in the order of the detections; one that was refused has its error.

    Raises:
        InvalidInputError: An argument cannot be used.
    """
    options = checked_options(options)
    if (as_flag("together", together) and options.shape.joint) or camera.focal_sigma:
        scene = reconstruct_scene(
            [detection.evidence for detection in detections],
            camera,
            prior=prior,
            ground=ground,
            size_prior=size_prior,
            options=options,
            evidence=evidence,
            extra_factors=extra_factors,
        )
        solved = dict(zip(scene.numbers, scene.vehicles, strict=True))
        return [FromImage(d, solved.get(i), scene.refused.get(i), scene.camera) for i, d in enumerate(detections)]
    if len(extra_factors):
        fix = "Let the vehicles be solved together (together=True, joint=True): else each has a graph of its own."
        raise InvalidInputError("extra_factors", f"{len(extra_factors)} factors", fix)
    vehicles = []
    for detection in detections:
        try:
            result = reconstruct_detection(
                detection, camera, options=options, prior=prior, ground=ground, size_prior=size_prior, evidence=evidence
            )
            vehicles.append(FromImage(detection, result, None, camera))
        except FgreconError as error:
            vehicles.append(FromImage(detection, None, error, camera))
    return vehicles


def reconstruct_image(
    image: NDArray[Any] | str | Path,
    camera: Camera | ArrayLike | None = None,
    boxes: ArrayLike | None = None,
    *,
    vehicle_detector: VehicleDetector | None = None,
    keypoint_detector: KeypointDetector | None = None,
    prior: ShapePrior | str | Path = "car14",
    ground: Ground | float | None = None,
    size_prior: SizesLike | None = None,
    options: Options | None = None,
    together: bool = True,
    classes: Sequence[VehicleClass | None] | Literal["detected", "keypoints"] | None = None,
    evidence: Sequence[Evidence] = (),
    extra_factors: Sequence[gtsam.NonlinearFactor] = (),
) -> list[FromImage]:
    """Pose and shape of the vehicles in an image.

    Args:
        image: (H, W, 3) RGB, or grey; 8 or 16 bits; or the path of an image file.
        camera: The camera that took it, or its matrix (3, 3), or (fx, fy, cx, cy). None takes the focal length from the
            file's EXIF data, or lets the vehicles tell it: distances are then rough.
        boxes: (N, 4) x1, y1, x2, y2 in pixels, of the outlines, unless `options.box` says otherwise (`cuboid` for
            KITTI's labels); None lets the vehicle detector find them.
        vehicle_detector: Finds the boxes where none are given; None for that of the package.
        keypoint_detector: Finds the keypoints; None for the networks of the package. All boxes go to it in one call.
        prior: Shape prior, or its name, or the path of its file; of the category of the keypoint detector.
        ground: Ground plane; a number is the height in metres of a level camera; None assumes nothing.
        size_prior: Fleet by name (`fgrecon.SIZE_PRIORS`), or a size prior; None takes sizes from the shape prior.
        options: Settings. Where the package's detector finds the boxes, `surface` is `detected`.
        together: Whether the vehicles share one ground that is a variable (`fgrecon.reconstruct_scene`); else, and
            where the pose is not to move with the shape (`joint=False`), each is solved alone. Where the focal length
            is not known they are solved together in any case.
        classes: Which class the vehicle in each box is of, which says how large it is; `detected` for what the vehicle
            detector says; or `keypoints` for the kinds that the keypoint networks say. None where nobody says.
        evidence: What other sensors say of the vehicles, such as `fgrecon.Points` of a scan in the camera's frame, a
            `fgrecon.DepthMap`, a `fgrecon.StereoPair` whose left image this is, or a `fgrecon.Mask` of each.
        extra_factors: The caller's own factors on the poses X(v, 0) and lambdas L(v), v the number of the box, and the
            ground G(0), as `fgrecon.reconstruct_scene` has them; the vehicles have to be solved together.

    Returns:
        The vehicles, in the order of the boxes; one that was refused has its error. Empty where there is none.

    Raises:
        InvalidInputError: An argument cannot be used, detector and prior are of different categories, or a detector
            returns something else than its protocol says (`fgrecon.perception.protocols`).

    Warns:
        AssumedCameraWarning: No camera is given, and the file does not tell one.
    """
    options = checked_options(options)
    shape_prior = load_prior(prior)
    pixels, from_exif = read_photograph(image) if isinstance(image, str | Path) else (as_rgb8(image), None)
    known = from_exif if camera is None else Camera.of(camera)
    sized = Camera.of_unknown(pixels.shape[1], pixels.shape[0]) if known is None else known.with_size_of(pixels)
    tracks: tuple[int, ...] = ()
    if boxes is None:
        found = large_vehicles(pixels, vehicle_detector or NanodetVehicleDetector())
        corners, named, tracks = found.boxes, found.classes, found.tracks
        options = for_detected(options) if vehicle_detector is None else options
    else:
        corners, named = as_finite("boxes", as_rows("boxes", boxes, 4), (None, 4)), ()
    networks = shipped_cascade() if keypoint_detector is None else keypoint_detector
    detections = find_keypoints(networks, pixels, corners, shape_prior.category)
    if classes == "keypoints":
        classes = [None if one.kinds is None else VehicleClass(one.kinds) for one in detections]
    detections = _with_classes(detections, named if classes == "detected" else classes)
    how: dict[str, Any] = {"ground": ground, "size_prior": size_prior, "options": options, "together": together}
    how |= {"evidence": with_depths(evidence, pixels, sized), "extra_factors": extra_factors}
    vehicles = reconstruct_detections(detections, sized, prior=shape_prior, **how)
    estimated = next((one.camera for one in vehicles if one.result is not None), None)
    if known is None and estimated is not None:
        _warn_of_camera(estimated)
    return [replace(one, track=track) for one, track in zip(vehicles, tracks, strict=True)] if tracks else vehicles


def _with_classes(detections: list[Detection], classes: Sequence[VehicleClass | None] | None) -> list[Detection]:
    """Detections that know which class of vehicle each is."""
    if classes is None:
        return detections
    each = as_list("classes", classes, VehicleClass, gaps=True)
    if len(each) != len(detections):
        fix = "Give one for each box, or None; `detected` needs a vehicle detector that says."
        raise InvalidInputError("classes", f"{len(each)} for {len(detections)} vehicles", fix)
    return [
        one if kind is None else replace(one, observation=one.observation.with_evidence([kind]))
        for one, kind in zip(detections, each, strict=True)
    ]


def _warn_of_camera(estimated: Camera) -> None:
    message = (
        f"No camera is given: the vehicles say that its focal length is {estimated.matrix[0, 0]:.0f} pixels, to "
        f"{100 * estimated.focal_sigma:.0f} %, and distances are as rough. Give camera=."
    )
    warnings.warn(message, AssumedCameraWarning, stacklevel=3)
