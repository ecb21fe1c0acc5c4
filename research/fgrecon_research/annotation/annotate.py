"""From images with labelled boxes to the keypoints of their vehicles."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.calibration.labelled_boxes import LeftOut, Reason, Selection
from fgrecon.core.box3d import Box3D
from fgrecon.core.camera import Camera
from fgrecon.core.detection import Detection
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.evidence import Points
from fgrecon.core.observation import Observation
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.io.images import read_image
from fgrecon.io.kitti_files import Drive, DriveFrame
from fgrecon.perception.keypoints.detect import large_enough
from fgrecon.perception.protocols import KeypointDetector, find_keypoints
from fgrecon_research.annotation.annotation import Annotation, Fit, Solid, solid_of
from fgrecon_research.annotation.known_box import BoxedView, fit_known_boxes
from fgrecon_research.annotation.unboxed import Unboxed, fit_unboxed

_ALIKE = "Car", "Van"  # what the shape of a car fills
_FLAT = "Pedestrian", "Person_sitting", "Cyclist", "DontCare"  # their boxes are mostly air


@dataclass(frozen=True, eq=False)
class _Member:
    """A vehicle in one image, and what the network found there."""

    frame: DriveFrame
    row: int
    camera: Camera
    found: Detection

    @property
    def track(self) -> int:
        """Number of its track."""
        return int(self.frame.tracks[self.row])

    @property
    def box(self) -> Box3D:
        """Its labelled box in the camera's frame."""
        return _box(self.frame, self.row)

    def with_points(self, points: Points) -> _Member:
        """It, with a scan as evidence."""
        observation = self.found.observation.with_evidence([points])
        return replace(self, found=replace(self.found, observation=observation))


def annotate(
    drive: Drive,
    detector: KeypointDetector,
    prior: ShapePrior,
    selection: Selection | None = None,
    progress: Callable[[Sequence[Any], str], Iterable[Any]] = lambda things, _: things,
    unboxed: Unboxed | None = None,
    points: Callable[[DriveFrame], Points | None] | None = None,
) -> tuple[list[Annotation], list[LeftOut]]:
    """Find the keypoints of a drive's vehicles, all images of each together.

    Args:
        drive: Images with labelled boxes.
        detector: Network whose points are evidence.
        prior: Shape prior of its category; where it has no surface, a hull of its keypoints stands for it.
        selection: Which objects.
        progress: Shows how far each loop is.
        unboxed: What is known of vehicles without 3D boxes, which then are reconstructed; None leaves them out.
        points: A LiDAR's points of a frame, which tell where a vehicle is and how it is shaped; None where it has none.

    Returns:
        The annotations by frame and track; and every other object of the selected kinds, with the reason.

    Raises:
        InvalidInputError: An image cannot be read, or the detector is of another category than the prior or returns
            something else than it should.
    """
    selection = Selection() if selection is None else selection
    left: list[LeftOut] = []
    boxed: dict[int, list[_Member]] = defaultdict(list)
    others: list[_Member] = []
    for frame in progress(drive.frames, "Keypoints"):
        rows, unselected = selection.judge(frame)
        left += unselected
        usable = frame.boxed[rows] | (unboxed is not None)
        left += [_left_out(frame, row, Reason.NO_BOX) for row in rows[~usable]]
        members = _seen(frame, rows[usable], detector, prior, left)
        scan = None if points is None or not members else points(frame)
        for member in members if scan is None else [one.with_points(scan) for one in members]:
            (boxed[member.track] if frame.boxed[member.row] else others).append(member)
    found: list[tuple[_Member, Fit | Reason]] = []
    for _, members in progress(sorted(boxed.items()), "Shapes"):
        views = [BoxedView(one.found.observation, one.camera, one.box) for one in members]
        found += zip(members, fit_known_boxes(views, prior), strict=True)
    if unboxed is not None:
        fitted = fit_unboxed(_by_frame(others), prior, unboxed, progress)
        found += [(one, fitted[one.frame.number, one.track]) for one in others]
    left += [_left_out(member.frame, member.row, fit) for member, fit in found if isinstance(fit, Reason)]
    fits = {(member.frame.number, member.row): fit for member, fit in found if isinstance(fit, Fit)}
    made = [
        Annotation.of(*(member.frame, member.row, member.camera, member.found, fit), _nearer(member, prior, fits))
        for member, fit in found
        if isinstance(fit, Fit)
    ]
    made.sort(key=lambda a: (a.frame.number, a.track))
    left.sort(key=lambda one: (one.frame, one.track))
    return made, left


def _by_frame(members: Sequence[_Member]) -> dict[int, tuple[Camera, dict[int, Observation]]]:
    """What each frame shows, by its number."""
    frames: dict[int, tuple[Camera, dict[int, Observation]]] = {}
    for one in members:
        _, vehicles = frames.setdefault(one.frame.number, (one.camera, {}))
        if one.track in vehicles:
            value = f"track {one.track} twice in frame {one.frame.number}"
            raise InvalidInputError("labels", value, "Give every vehicle of a frame a number of its own.")
        vehicles[one.track] = one.found.observation
    return frames


def _seen(
    frame: DriveFrame, rows: NDArray[np.intp], detector: KeypointDetector, prior: ShapePrior, left: list[LeftOut]
) -> list[_Member]:
    """What the network finds of a frame's objects; those whose boxes are not in the image are added to `left`."""
    if not len(rows):
        return []
    image = read_image(frame.image)
    height, width = image.shape[:2]
    camera = replace(frame.calibration.camera, image_size=(width, height))
    boxes = np.clip(frame.objects.box[rows], 0.0, [width - 1.0, height - 1.0] * 2)
    sides = boxes[:, 2:] - boxes[:, :2]
    within = (sides >= 1.0).all(axis=1) & large_enough(boxes)
    left += [_left_out(frame, row, Reason.OUTSIDE) for row in rows[~within]]
    found = find_keypoints(detector, image, boxes[within], prior.category)
    return [_Member(frame, int(row), camera, one) for row, one in zip(rows[within], found, strict=True)]


def _left_out(frame: DriveFrame, row: int, reason: Reason) -> LeftOut:
    return LeftOut(frame.number, int(frame.tracks[row]), reason, frame.objects.kind[row])


def _box(frame: DriveFrame, row: int) -> Box3D:
    o = frame.objects
    return Box3D(o.location[row] + frame.calibration.label_offset, float(o.rotation_y[row]), o.size[row])


def _nearer(one: _Member, prior: ShapePrior, fits: Mapping[tuple[int, int], Fit]) -> tuple[Solid, ...]:
    """Surfaces of the objects that are nearer than one and touch its 2D box."""
    frame, row = one.frame, one.row
    o = frame.objects
    x1, y1, x2, y2 = o.box[row]
    distance = _distance(frame, row, fits)
    solids = []
    for other, kind in enumerate(o.kind):
        a1, b1, a2, b2 = o.box[other]
        touches = a1 < x2 and a2 > x1 and b1 < y2 and b2 > y1
        if other == row or kind in _FLAT or not touches or _distance(frame, other, fits) >= distance:
            continue
        if frame.boxed[other]:
            solids.append(solid_of(_box(frame, other), prior if kind in _ALIKE else None))
        else:
            solids.append(fits[frame.number, other].solid)
    return tuple(solids)


def _distance(frame: DriveFrame, row: int, fits: Mapping[tuple[int, int], Fit]) -> float:
    """Of an object from the camera, metres; infinite where nothing tells."""
    if frame.boxed[row]:
        return float(np.linalg.norm(frame.objects.location[row] + frame.calibration.label_offset))
    fit = fits.get((frame.number, row))
    return np.inf if fit is None else float(np.linalg.norm(fit.result.location))
