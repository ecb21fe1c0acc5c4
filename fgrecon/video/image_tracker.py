"""Trackers of images: one image after the other in, estimates of vehicles out; and a baseline, every image on its own.

image ---- FrameDetector: boxes, keypoints ---- Follower: ids, by association ---- fgrecon.Tracker ---- estimates by id
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.checks import as_time
from fgrecon.core.choices import ClassSource
from fgrecon.core.errors import FgreconError, InvalidInputError
from fgrecon.core.evidence import Evidence
from fgrecon.core.observation import Observation
from fgrecon.core.options import Options
from fgrecon.core.settings import one_of
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.vehicle_estimate import VehicleEstimate
from fgrecon.io.catalogue import load_prior
from fgrecon.io.images import read_image
from fgrecon.io.poses import CameraPoses
from fgrecon.io.source_frames import SourceFrame
from fgrecon.perception.boxes import for_detected
from fgrecon.perception.keypoints.detect import as_rgb8, shipped_cascade
from fgrecon.perception.protocols import KeypointDetector, VehicleDetector, check_category
from fgrecon.perception.stereo import with_depths
from fgrecon.perception.vehicles import NanodetVehicleDetector
from fgrecon.solve.inputs import as_camera_pose, as_ground, calibrated
from fgrecon.solve.pipeline import reconstruct
from fgrecon.solve.tracker import Tracker
from fgrecon.video.association import Association, GatedAssociation
from fgrecon.video.camera_path import CameraPath
from fgrecon.video.follow import Follower, TrackedFrame
from fgrecon.video.frame_detector import FrameDetector


class ImageTracker:
    """Follows the vehicles that a camera sees, image by image.

    Attributes:
        tracker: Estimates the vehicles: its `smooth` gives those of the past by all images.
        frame: What the last image shows, by id: boxes, scores, keypoints, why vehicles have no estimate; None before
            the first one.
    """

    def __init__(
        self,
        *,
        prior: ShapePrior | str | Path = "car14",
        options: Options | None = None,
        vehicle_detector: VehicleDetector | None = None,
        keypoint_detector: KeypointDetector | None = None,
        association: Association | None = None,
        classes: Literal["detected", "keypoints"] | None = None,
        **arguments: Any,
    ) -> None:
        """Prepare for vehicles of one category.

        Args:
            prior: Shape prior, or its name, or the path of its file; of the category of the keypoint detector.
            options: Settings. Where the package's detector finds the boxes, `surface` is `detected`.
            vehicle_detector: Finds the boxes; None for that of the package.
            keypoint_detector: Finds the keypoints; None for the networks of the package.
            association: Gives ids; None for one that forgets vehicles that it has not seen for two seconds, the
                tracker's past of them as well. `GatedAssociation()` keeps that for `smooth`.
            classes: Who says of which class vehicles are, as in `fgrecon.reconstruct_image`; None where all are cars.
            arguments: Further ones of `fgrecon.Tracker`: size_prior, window, shared_ground, past, motion_factors.

        Raises:
            InvalidInputError: An argument cannot be used; names it, its value and the fix.
        """
        shape_prior = load_prior(prior)
        networks = shipped_cascade() if keypoint_detector is None else keypoint_detector
        check_category(networks, shape_prior.category)
        boxes = NanodetVehicleDetector() if vehicle_detector is None else vehicle_detector
        chosen = for_detected(options) if vehicle_detector is None else options
        self.tracker = Tracker(prior=shape_prior, options=chosen, **arguments)
        self.frame: TrackedFrame | None = None
        source = None if classes is None else one_of(ClassSource, "classes", classes)
        self._look = FrameDetector(
            shape_prior.category, vehicle_detector=boxes, keypoint_detector=networks, classes=source
        )
        self._association = GatedAssociation(given_up=self.tracker.forget) if association is None else association
        self._places: dict[int, NDArray[np.float64]] = {}  # of the camera in the image at hand, by its number
        self._follower: Follower | None = None
        self._evidence: Sequence[Evidence] = ()

    def update(
        self,
        time: float,
        image: NDArray[Any] | str | Path,
        *,
        camera: Camera | ArrayLike,
        world_T_camera: ArrayLike | None = None,
        ground: Ground | float | None = None,
        evidence: Sequence[Evidence] = (),
    ) -> dict[int, VehicleEstimate]:
        """Take an image; the networks look at it.

        Args:
            time: Of the image, seconds, later than of all before.
            image: (H, W, 3) RGB, or grey; 8 or 16 bits; or the path of an image file.
            camera: The camera that took it, or its matrix (3, 3), or (fx, fy, cx, cy). It may zoom; a camera that looks
                elsewhere needs an `ImageTracker` of its own, since ids go on by where boxes were in the image before.
            world_T_camera: (4, 4) pose of the camera in a world that stands still; None where it is not known.
            ground: Ground plane in the camera's frame; a number is the height in metres of a level camera.
            evidence: What other sensors say of the vehicles, as in `fgrecon.reconstruct_image`.

        Returns:
            The estimates by id, by this image and those before.

        Raises:
            InvalidInputError: An argument cannot be used, or a detector returns something else than its protocol says.
        """
        time = as_time(time)
        if self.frame is not None and not time > self.frame.time:
            fix = f"Give the images of one camera in order: the last one was at {self.frame.time:.10g} s."
            raise InvalidInputError("time", time, fix)
        pixels = read_image(image) if isinstance(image, str | Path) else as_rgb8(image)
        seen_by = calibrated("camera", Camera.of(camera)).with_size_of(pixels)
        plane, number = as_ground(ground), 0 if self.frame is None else self.frame.number + 1
        self._places.clear()
        if world_T_camera is not None:
            self._places[number] = as_camera_pose(world_T_camera)
        record = self._look(SourceFrame(number, time, f"image {number}", pixels))
        if self._follower is None:
            self._follower = Follower(
                *(self.tracker, self._association, seen_by),
                path=CameraPath(CameraPoses(self._places)),
                sense=lambda _: self._evidence,
            )
        self._evidence = with_depths(evidence, pixels, seen_by)
        self._follower.camera, self._follower.ground = seen_by, plane
        self.frame = self._follower(record)
        return dict(self.frame.estimates)


class SingleImageTracker:
    """A tracker (`fgrecon.video.VehicleTracker`) that reconstructs every image on its own.

    Attributes:
        refused: Why vehicles of the last frame have no estimate, by id.
    """

    refused: Mapping[int, FgreconError]

    def __init__(self, **arguments: Any) -> None:
        """Take settings of `fgrecon.reconstruct`: prior, size_prior, options."""
        self._arguments = arguments
        self._tracks: dict[int, list[VehicleEstimate]] = {}
        self.refused = {}

    def update(
        self,
        time: float,
        observations: Mapping[int, Observation],
        *,
        camera: Camera,
        world_T_camera: Array | None = None,
        ground: Ground | None = None,
        motion_covariance: Array | None = None,  # noqa: ARG002 - one image knows of no motion
        evidence: Sequence[Evidence] = (),
        estimated: bool = True,  # noqa: ARG002 - nor of frames to come
    ) -> Mapping[int, VehicleEstimate]:
        """The estimates of the vehicles that can be reconstructed, by id."""
        estimates: dict[int, VehicleEstimate] = {}
        refused: dict[int, FgreconError] = {}
        for identity, observation in observations.items():
            try:
                result = reconstruct(observation, camera, ground=ground, evidence=evidence, **self._arguments)
            except FgreconError as error:
                refused[identity] = error
                continue
            pose = result.camera_T_object
            estimates[identity] = VehicleEstimate(
                id=identity,
                time=time,
                reconstruction=result,
                velocity=None,
                turn_rate=None,
                facing_probability=result.facing_probability,
                world_T_object=None if world_T_camera is None else world_T_camera @ pose,
            )
            self._tracks.setdefault(identity, []).append(estimates[identity])
        self.refused = refused
        return estimates

    def placed(self, vehicle: int) -> tuple[Array, Array] | None:
        """Pose (4, 4) of a vehicle in its last image, and its keypoints (K, 3) in its own; None of one without."""
        if vehicle not in self._tracks:
            return None
        last = self._tracks[vehicle][-1].reconstruction
        return last.camera_T_object, last.wireframe

    def forget(self, vehicle: int) -> None:
        """Let go of a vehicle's estimates; one that is not there is none to let go of."""
        self._tracks.pop(vehicle, None)

    def smooth(self) -> Mapping[int, Sequence[VehicleEstimate]]:
        """The same estimates once more."""
        return self._tracks
