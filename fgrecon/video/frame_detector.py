"""Detection in a frame: boxes by the detector or given, keypoints by the networks or given."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.category import Category
from fgrecon.core.choices import ClassSource
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.source_frames import SourceFrame
from fgrecon.perception.boxes import classes_at
from fgrecon.perception.keypoints.detect import check_box, large_enough
from fgrecon.perception.protocols import KeypointDetector, VehicleDetector, class_by, find_keypoints, find_vehicles
from fgrecon.perception.vehicles import Vehicles
from fgrecon.video.records import FrameRecord, Sighting


class FrameDetector:
    """Looks at one frame after the other."""

    def __init__(
        self,
        category: Category,
        *,
        vehicle_detector: VehicleDetector | None = None,
        keypoint_detector: KeypointDetector | None = None,
        given: Mapping[int, Sequence[Sighting]] | None = None,
        classes: ClassSource | None = None,
    ) -> None:
        """Take what looks.

        Args:
            category: Category of the keypoints.
            vehicle_detector: Finds the boxes where none are given, or says of which class those are.
            keypoint_detector: Finds the keypoints where none are given.
            given: Vehicles by the number of their frame, instead of the detector's.
            classes: Who says of which class vehicles are; None where all are cars.
        """
        self.category, self._classes = category, classes
        self._tracked: bool | None = None  # whether the detector gives ids; None before it has found a vehicle
        self._vehicles, self._keypoints, self.given = vehicle_detector, keypoint_detector, given

    def __call__(self, frame: SourceFrame) -> FrameRecord:
        """What a frame shows; one that cannot be read shows what was given for it, and one of another size nothing.

        Raises:
            InvalidInputError: A detector returns something else than its protocol says.
        """
        return self.record(frame, self.vehicles(frame))

    def vehicles(self, frame: SourceFrame) -> Sequence[Sighting]:
        """The vehicles of a frame, keypoints of those alone for which they were given; the arguments are the call's."""
        if self.given is not None:
            empty = frame.other_size or frame.left_out
            return () if empty else self._of_classes(self.given.get(frame.number, ()), frame.image)
        if frame.image is None:
            return ()
        assert self._vehicles is not None
        found = find_vehicles(self._vehicles, frame.image)
        found = self._of_tracker(found, frame.name)
        nothing = [None] * len(found)
        ids, kinds, named = found.tracks or nothing, found.kinds or nothing, found.classes or nothing
        each = zip(found.boxes, found.scores, ids, kinds, named, strict=True)
        return [Sighting(box, float(s), i, None, k, one) for box, s, i, k, one in each if large_enough(box)]

    def _of_tracker(self, found: Vehicles, name: str) -> Vehicles:
        """What counts of an image: where a detector gives ids, those alone that have one.

        Raises:
            InvalidInputError: It gave none to vehicles before, whose ids are those of this program.
        """
        if len(found) and bool(found.tracks) != self._tracked:
            if self._tracked is False:
                fix = "Return no vehicles as long as none has an id."
                raise InvalidInputError("vehicle_detector", f"ids from {name} on", fix)
            if self._tracked:
                return found.take(np.array([], dtype=np.intp))
            self._tracked = bool(found.tracks)
        return found

    def _of_classes(self, given: Sequence[Sighting], image: NDArray[np.uint8] | None) -> Sequence[Sighting]:
        """Given vehicles of a frame, of the classes that the vehicle detector says where it is to say them."""
        if self._classes is not ClassSource.DETECTED or image is None or not given:
            return given
        assert self._vehicles is not None
        classes = classes_at(np.array([one.box for one in given]), image, self._vehicles)
        return [replace(one, vehicle_class=known) for one, known in zip(given, classes, strict=True)]

    def record(self, frame: SourceFrame, vehicles: Sequence[Sighting]) -> FrameRecord:
        """What the frame shows, by its `vehicles`."""
        image = frame.image
        sightings = [replace(s, vehicle_class=class_by(self._classes, s.vehicle_class, None)) for s in vehicles]
        if image is None:
            kept = tuple(sighting for sighting in sightings if sighting.observation is not None)
            return FrameRecord(frame.number, frame.time, frame.name, frame.problem, kept)
        limits = np.array([image.shape[1], image.shape[0]] * 2) - 1.0
        bare = [place for place, s in enumerate(sightings) if s.observation is None and _usable(s.box, image, limits)]
        boxes = np.array([np.clip(sightings[place].box, 0.0, limits) for place in bare]).reshape(-1, 4)
        if bare:
            assert self._keypoints is not None
            detections = find_keypoints(self._keypoints, image, boxes, self.category)
            for place, box, detection in zip(bare, boxes, detections, strict=True):
                known = class_by(self._classes, sightings[place].vehicle_class, detection.kinds)
                observation = replace(detection.evidence, box=box)
                sightings[place] = replace(sightings[place], box=box, observation=observation, vehicle_class=known)
        return FrameRecord(frame.number, frame.time, frame.name, None, tuple(sightings))


def _usable(box: NDArray[np.float64], image: NDArray[np.uint8], limits: NDArray[np.float64]) -> bool:
    """Whether the networks can look into a box: large enough, and enough of it in the image."""
    try:
        check_box(np.clip(box, 0.0, limits), image, "box")
    except InvalidInputError:
        return False
    return True
