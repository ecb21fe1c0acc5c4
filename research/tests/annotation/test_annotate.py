"""From a made-up drive to annotations, and every vehicle that has none with its reason."""

import json
from dataclasses import replace

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.evidence import Points
from fgrecon.core.size_prior import SizePrior
from fgrecon.io.kitti_files import read_drive, read_object_folder
from fgrecon_research.annotation import known_box
from fgrecon_research.annotation.annotate import LeftOut, Reason, Selection, annotate
from fgrecon_research.annotation.labels import vehicle_labels
from research.tests.annotation.streets import SIZE, Car, GivenKeypoints, write_drive

NEAR = Car((-2.0, 1.6, 9.0), 0.5)


def extent(car, prior):
    box = car.box(prior)
    return (box[2:] - box[:2]).max()


def test_keypoints_of_all_images_of_a_vehicle(scene, tmp_path):
    frames = [{7: NEAR, 3: Car((2.5, 1.6, 14.0), -1.4, "Van")}, {7: replace(NEAR, location=(-2.0, 1.6, 10.0))}]
    drive = read_drive(write_drive(tmp_path / "drive", scene.prior, frames))
    shown = []

    def progress(things, heading):
        shown.append((heading, len(things)))
        return things

    made, left = annotate(drive, GivenKeypoints(frames, scene.prior, noise=1.0), scene.prior, progress=progress)
    assert left == []
    assert shown == [("Keypoints", 2), ("Shapes", 2)]
    assert [(a.frame.number, a.track, a.kind) for a in made] == [(0, 3, "Van"), (0, 7, "Car"), (1, 7, "Car")]
    for annotation in made:
        car = frames[annotation.frame.number][annotation.track]
        off = np.linalg.norm(annotation.keypoints - car.keypoints(scene.prior), axis=1)
        assert off.max() < 0.03 * extent(car, scene.prior)
        assert annotation.camera.image_size == SIZE
        np.testing.assert_allclose(annotation.box, car.box(scene.prior), atol=1e-3)
        np.testing.assert_allclose(annotation.camera_T_object[:3, 3], car.location, atol=0.3)
        assert annotation.agreement > 0.95
        assert annotation.vertices[annotation.faces].shape[1:] == (3, 3)
        towards = np.arctan2(*(-car.pose()[:3, :3].T @ car.location)[[2, 0]])
        assert annotation.azimuth == pytest.approx(towards, abs=0.05)
        hidden = annotation.visible < 0.5
        assert 2 <= hidden.sum() <= 9
    first, second = (a for a in made if a.track == 7)
    np.testing.assert_allclose(  # one shape
        *((a.vertices - a.camera_T_object[:3, 3]) @ a.camera_T_object[:3, :3] for a in (first, second)), atol=1e-9
    )


def test_every_vehicle_of_a_wanted_kind_is_reported(scene, tmp_path):
    gone = Car((1.0, 1.6, 12.0), 0.3, truncation=0.7)
    few = Car((2.5, 1.6, 11.0), 1.0)
    cars = {
        1: NEAR,
        2: Car((3.0, 1.6, 60.0), 1.0),
        3: replace(gone, truncation=0.0, occlusion=3),
        4: gone,
        5: replace(few, boxed=False),
        6: few,
        8: replace(few, kind="Pedestrian"),
        9: Car((-5.0, 1.6, 12.0), 0.0),
    }
    folder = write_drive(tmp_path / "drive", scene.prior, [cars])
    (folder / "clean_tracks.json").write_text(json.dumps({f"{t} {c.kind}": [0] for t, c in cars.items() if t != 9}))

    def lose(number, car, points, confidence):
        return (np.where(np.arange(14)[:, None] < 2, points, np.nan) if car is not NEAR else points), confidence

    made, left = annotate(read_drive(folder), GivenKeypoints([cars], scene.prior, changed=lose), scene.prior)
    assert [a.track for a in made] == [1]
    assert left == [
        LeftOut(0, 2, Reason.SMALL, "Car"),
        LeftOut(0, 3, Reason.OCCLUDED, "Car"),
        LeftOut(0, 4, Reason.TRUNCATED, "Car"),
        LeftOut(0, 5, Reason.NO_BOX, "Car"),
        LeftOut(0, 6, Reason.FEW_POINTS, "Car"),
        LeftOut(0, 9, Reason.DRAWN_OVER, "Car"),
    ]
    assert len({str(reason) for reason in Reason}) == len(Reason)


def test_a_network_that_disagrees_is_no_reason(scene, tmp_path):
    frames = [{1: NEAR}]
    drive = read_drive(write_drive(tmp_path / "drive", scene.prior, frames))

    def nonsense(number, car, points, confidence):
        return np.random.default_rng(1).uniform([0, 0], SIZE, points.shape), confidence

    made, left = annotate(drive, GivenKeypoints(frames, scene.prior, changed=nonsense), scene.prior)
    assert left == []
    assert made[0].agreement < 0.3
    off = np.linalg.norm(made[0].keypoints - NEAR.keypoints(scene.prior), axis=1)
    assert np.median(off) < 0.05 * extent(NEAR, scene.prior)


def test_what_is_nearer_hides(scene, tmp_path):
    far = Car((0.0, 1.6, 20.0), np.pi / 2)
    alone, behind = [{1: far}], [{1: far, 2: Car((0.3, 1.6, 12.0), 0.0)}]
    found = []
    for name, frames in (("alone", alone), ("behind", behind)):
        drive = read_drive(write_drive(tmp_path / name, scene.prior, frames))
        made, _ = annotate(drive, GivenKeypoints(frames, scene.prior), scene.prior)
        found.append(next(a for a in made if a.track == 1))
    assert found[0].before == ()
    assert (found[0].visible > 0.5).sum() >= 4
    assert len(found[1].before) == 1
    wheels = [0, 1, 2, 3]
    assert (found[1].visible[wheels] == 0.0).all()
    assert (found[1].visible <= found[0].visible + 1e-12).all()


def test_the_border_of_the_image_hides(scene, tmp_path):
    frames = [{1: Car((-4.2, 1.6, 10.0), 0.3, truncation=0.2)}]
    drive = read_drive(write_drive(tmp_path / "drive", scene.prior, frames))
    ((annotation,), _) = annotate(drive, GivenKeypoints(frames, scene.prior), scene.prior)
    outside = annotation.keypoints[:, 0] < -0.5
    assert outside.any()
    assert (annotation.visible[outside] == 0.0).all()
    (label,) = vehicle_labels([("drive", annotation)], scene.prior.category, {}).vehicles
    np.testing.assert_array_equal(label.flags == 0, outside)


def test_labels_hold_what_the_annotation_says(scene, tmp_path):
    frames = [{1: NEAR}]
    drive = read_drive(write_drive(tmp_path / "drive", scene.prior, frames))
    made, _ = annotate(drive, GivenKeypoints(frames, scene.prior), scene.prior)
    labels = vehicle_labels([("d", one) for one in made], scene.prior.category, {"by": "a test"})
    assert labels.skeleton == scene.prior.category.edges
    assert labels.info == {"by": "a test"}
    (label,) = labels.vehicles
    assert label.rotation_y == pytest.approx(0.5, abs=0.05)
    low, high = label.corners.min(axis=0), label.corners.max(axis=0)
    assert (made[0].keypoints > low).all()  # the box's corners are around it
    assert (made[0].keypoints < high).all()
    front, rear = label.corners[4:].mean(axis=0), label.corners[:4].mean(axis=0)
    assert front[0] > rear[0]  # it drives to the right
    assert label.corners[[0, 1, 4, 5], 1].min() > label.corners[[2, 3, 6, 7], 1].max() - 40
    assert label.image.matrix.tolist() == drive.calibration.camera.matrix.tolist()


def test_a_prior_without_a_surface(scene, tmp_path):
    frames = [{1: NEAR, 2: Car((0.5, 1.6, 20.0), 1.5)}]
    drive = read_drive(write_drive(tmp_path / "drive", scene.prior, frames))
    made, _ = annotate(drive, GivenKeypoints(frames, scene.prior), replace(scene.prior, surface=None))
    assert len(made) == 2
    labels = vehicle_labels([("d", one) for one in made], scene.prior.category, {})
    assert len(labels.vehicles) == 2


def test_a_detector_of_another_category_is_refused(scene, tmp_path):
    frames = [{1: NEAR}]
    drive = read_drive(write_drive(tmp_path / "drive", scene.prior, frames))
    with pytest.raises(InvalidInputError, match="lorry"):
        annotate(drive, GivenKeypoints(frames, scene.prior, category="lorry"), scene.prior)


@pytest.mark.parametrize(
    ("field", "value"),
    [("kinds", ()), ("height", np.nan), ("occlusion", -1), ("truncation", 1.5), ("truncation", np.nan)],
)
def test_limits_that_mean_nothing_are_refused(field, value):
    with pytest.raises(InvalidInputError, match=f"selection.{field}"):
        Selection(**{field: value})


@pytest.mark.data
@pytest.mark.slow
def test_against_keypoints_marked_by_hand(data, scene):
    from fgrecon.perception.keypoints.detect import shipped_cascade
    from fgrecon_research.training.keypoints.marks import read_street_marks

    folder = data / "kitti_object" / "training"
    marks = {
        m.name: m for m in read_street_marks(data / "hand_labels" / "kitti_object_keypoints14.json", folder / "image_2")
    }
    made, _ = annotate(read_object_folder(folder), shipped_cascade(), scene.prior)
    errors, counted = [], 0
    for one in made:
        mark = marks.get(f"{one.frame.image.stem}/{one.track - one.frame.tracks[0]}")
        if mark is not None:
            counted += 1
            errors.append(np.linalg.norm(one.keypoints - mark.keypoints, axis=1)[mark.visible] / mark.extent)
    assert counted == len(marks)
    assert np.median(np.concatenate(errors)) < 0.03


def test_a_lidars_points_tell_the_shape_of_a_vehicle_whose_box_is_vague(scene, tmp_path, monkeypatch):
    """Points of a longer car than its box, which is not known well, say how long it is."""
    car = scene.prior.for_fleet(SizePrior("longer", np.array([4.9, 1.75, 1.6]), np.full(3, 0.1)))
    frames = [{7: replace(NEAR, location=(-2.0, 1.6, 9.0 + t))} for t in range(2)]
    drive = read_drive(write_drive(tmp_path / "drive", scene.prior, frames))
    pose = NEAR.pose()
    assert car.surface is not None
    sensor = -pose[:3, :3].T @ pose[:3, 3]
    corners = car.surface.mean[car.surface.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    centres = corners.mean(axis=1)
    shown = centres[((sensor - centres) * normals).sum(axis=1) > 0.0]

    def points(frame):
        place = np.array(frames[frame.number][7].location)
        return Points(shown @ pose[:3, :3].T + place, 0.02) if frame.number == 0 else None

    detector = GivenKeypoints(frames, scene.prior, noise=1.0)
    vague = replace(known_box.SETTINGS, shift_sigma=0.5, size_share=0.15)
    monkeypatch.setattr(known_box, "SETTINGS", vague)
    lengths = {}
    for name, more in (("alone", {}), ("lidar", {"points": points})):
        made, left = annotate(drive, detector, scene.prior, **more)
        assert not left
        local = (made[0].vertices - made[0].camera_T_object[:3, 3]) @ made[0].camera_T_object[:3, :3]
        lengths[name] = np.ptp(local[:, 0])
    truth = np.ptp(car.surface.mean[:, 0])
    assert abs(lengths["lidar"] - truth) < 0.6 * abs(lengths["alone"] - truth)
