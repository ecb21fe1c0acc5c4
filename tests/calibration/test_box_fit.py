"""Where a detector's boxes lie: recovered from boxes of known make, kept in a file, used by a solve."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import fgrecon
from fgrecon.calibration.box_fit import DetectedOutline, detected_outlines, fit_boxes
from fgrecon.core.detector_calibration import BoxSource
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.catalogue import load_prior
from fgrecon.io.kitti_files import read_drive
from tests.cars import CAMERA, observe, yaw_pose

EDGES = np.array([-0.05, 0.02, 0.03, 0.01])


def made(count=400, spread=0.02):
    """Boxes of a detector that errs by EDGES, and by so much of the longer side."""
    rng = np.random.default_rng(5)
    for _ in range(count):
        corner, size = rng.uniform(0.0, 500.0, 2), rng.uniform(30.0, 200.0, 2)
        detected = np.array([*corner, *(corner + size)])
        yield DetectedOutline(detected, detected - EDGES * np.tile(size, 2) + spread * size.max() * rng.normal(size=4))


def test_what_made_them_is_found():
    found = fit_boxes(list(made()))
    np.testing.assert_allclose([found.left, found.upper, found.right, found.lower], EDGES, atol=0.006)
    assert found.spread == pytest.approx(0.02, rel=0.1)
    with pytest.raises(InvalidInputError, match="20 detected cars that are visible as a whole"):
        fit_boxes(list(made(20)))


def test_a_file_keeps_it_and_a_solve_uses_it(tmp_path):
    source = BoxSource(-0.05, 0.02, 0.03, 0.01, spread=0.02)
    kept = fgrecon.save_calibration(fgrecon.DetectorCalibration(boxes=source), tmp_path / "detector.json")
    found = fgrecon.load_calibration(kept)
    assert found.boxes == source
    options = found.applied(fgrecon.Options(box="detected"))
    assert options.box.edges == tuple(EDGES)
    kept.write_text(kept.read_text().replace("-0.05", '"wide"'))
    with pytest.raises(InvalidInputError, match=r"boxes\.left"):
        fgrecon.load_calibration(kept)

    seen = observe(load_prior("car14"), yaw_pose(0.6))
    size = np.tile(seen.box[2:] - seen.box[:2], 2)
    moved = replace(seen, box=seen.box + EDGES * size / (1.0 - np.tile(EDGES[2:] - EDGES[:2], 2)))
    as_drawn = fgrecon.reconstruct(seen, CAMERA, options=fgrecon.Options(box="surface"))
    fitted, unfitted = (
        fgrecon.reconstruct(moved, CAMERA, options=o) for o in (options, fgrecon.Options(box="surface"))
    )
    assert abs(fitted.location - as_drawn.location).max() < 0.3 * abs(unfitted.location - as_drawn.location).max()


@pytest.mark.data
def test_boxes_of_labels_are_wider_than_outlines(data):
    """KITTI's labelled boxes enclose the projected 3D box, which is larger than the outline on every side."""
    drive = read_drive(data / "kitti_video" / "kitti_tracking_0002")
    frames = []
    for frame in drive.frames:
        objects = frame.objects
        boxes = [
            SimpleNamespace(kind=kind, occlusion=occlusion, truncation=truncation, index=index)
            for index, (kind, occlusion, truncation) in enumerate(
                zip(objects.kind, objects.occlusion.tolist(), objects.truncation.tolist(), strict=True)
            )
        ]
        seen = [SimpleNamespace(box=box) for box in objects.box]
        frames.append(SimpleNamespace(drive=drive.name, number=frame.number, boxes=boxes, sightings=seen))
    found = fit_boxes(list(detected_outlines([drive], frames, load_prior("car14"))))
    assert found.left < 0.0 < found.right
    assert found.upper < 0.0 < found.lower
    assert max(-found.left, -found.upper, found.right, found.lower) < 0.1
