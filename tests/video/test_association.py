"""Association on made-up streets, and on KITTI's labelled boxes without their ids."""

import numpy as np
import pytest

from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import box_overlaps
from fgrecon.io.kitti_files import read_drive
from fgrecon.video.association import AssociationSettings, Candidate, GatedAssociation, ground_contact

CAMERA = Camera(np.array([[720.0, 0, 620], [0, 720.0, 180], [0, 0, 1]]), image_size=(1242, 375))
GROUND = Ground.level(1.65)
CAR = np.array([[x, y, z] for x in (-0.9, 0.9) for y in (0.0, -1.5) for z in (-2.1, 2.1)])


def box_of(position):
    pixels = CAMERA.project(CAR + position)
    return np.concatenate([pixels.min(axis=0), pixels.max(axis=0)])


def seen_at(position, score=1.0):
    box = box_of(np.asarray(position))
    stands = ground_contact(box, CAMERA, GROUND)
    return Candidate(box, score) if stands is None else Candidate(box, score, *stands)


def crossing(time):
    """Two cars that pass each other, one behind the other: at 2 s they are in one line of sight."""
    return np.array([-4.0 + 2.0 * time, 1.65, 14.0]), np.array([6.0 - 3.0 * time, 1.65, 24.0])


def follow(scenes, association=None):
    """Ids by frame; `scenes` has time and candidates of each."""
    association = GatedAssociation() if association is None else association
    return [association(time, candidates) for time, candidates in scenes]


def test_crossing_cars_keep_their_ids():
    scenes = [(t, [seen_at(p) for p in crossing(t)]) for t in np.arange(0.0, 4.0, 0.1)]
    assert follow(scenes) == [[0, 1]] * len(scenes)


def test_a_car_that_is_hidden_for_a_while_is_reborn():
    association = GatedAssociation()
    scenes = []
    for t in np.arange(0.0, 4.0, 0.1):
        near, far = (seen_at(p) for p in crossing(t))
        hidden = box_overlaps(near.box[None], far.box[None])[0, 0] > 0.05
        scenes.append((t, [near] if hidden else [near, far]))
    found = follow(scenes, association)
    assert sum(len(ids) == 1 for ids in found) > 5
    assert {ids[1] for ids in found if len(ids) == 2} == {1}
    assert {ids[0] for ids in found} == {0}


def test_weak_detections_continue_tracks_and_begin_none():
    position = np.array([1.0, 1.65, 15.0])
    scenes = [(0.1 * t, [seen_at(position, score)]) for t, score in enumerate((0.4, 0.97, 0.4, 0.4))]
    assert follow(scenes) == [[None], [0], [0], [0]]


def test_after_a_while_a_track_is_dead():
    gone = []
    association = GatedAssociation(AssociationSettings(memory_seconds=1.0), given_up=gone.append)
    there = [seen_at([1.0, 1.65, 15.0])]
    assert follow([(0.0, there), (0.9, there), (2.0, there)], association) == [[0], [0], [1]]
    assert gone == [0]


def test_boxes_that_overlap_are_distinguished_by_where_they_stand():
    """A near car comes into the line of sight in the very frame in which the far one is not detected."""
    far, near = np.array([0.0, 1.65, 30.0]), np.array([0.3, 1.65, 18.0])
    boxes = box_of(far), box_of(near)
    assert box_overlaps(boxes[0][None], boxes[1][None])[0, 0] > 0.3
    assert follow([(0.0, [seen_at(far)]), (0.1, [seen_at(near)])]) == [[0], [1]]
    alone = [(0.0, [Candidate(boxes[0])]), (0.1, [Candidate(boxes[1])])]
    assert follow(alone) == [[0], [0]]


def test_boxes_that_overlap_are_distinguished_by_which_way_they_face():
    """One car half behind another, which faces the other way; a detector's boxes of them change places for a frame."""
    ahead, behind = np.eye(36)[[0, 18]] * 0.95 + 0.05 / 36
    left, right = np.array([100.0, 100.0, 160.0, 150.0]), np.array([125.0, 100.0, 185.0, 150.0])
    scenes = [(t, [Candidate(left, directions=ahead), Candidate(right, directions=behind)]) for t in (0.0, 0.1, 0.2)]
    nearer = 10.0 * np.array([1.0, 0.0, 1.0, 0.0])
    changed = [Candidate(left + nearer, directions=behind), Candidate(right - nearer, directions=ahead)]
    scenes.append((0.3, changed))
    assert follow(scenes) == [[0, 1], [0, 1], [0, 1], [1, 0]]
    deaf = GatedAssociation(AssociationSettings(direction_weight=0.0))
    assert follow(scenes, deaf)[-1] == [0, 1]
    other = [Candidate(one.box, directions=np.full(8, 0.125)) for one in changed]  # nothing to compare with
    assert follow([*scenes[:-1], (0.3, other)])[-1] == [0, 1]


def test_the_cameras_own_motion_is_taken_off():
    """The camera turns by 6 degrees a frame: boxes jump by their own width."""
    turn = np.radians(6.0)
    motion = np.eye(4)
    motion[:3, :3] = [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]]
    places, ids = [np.array([-4.0, 1.65, 20.0]), np.array([3.0, 1.65, 20.0])], []
    association = GatedAssociation()
    for number in range(4):
        ids.append(association(0.1 * number, [seen_at(p) for p in places], None if number == 0 else motion))
        places = [np.linalg.inv(motion)[:3, :3] @ p for p in places]
    assert ids[0] == [0, 1]


def test_a_given_velocity_predicts_the_box():
    """A car drives on for half a second unseen; its box in one frame does not tell how."""
    position, velocity = np.array([-6.0, 1.65, 14.0]), np.array([9.0, 0.0, 0.0])
    later = Candidate(box_of(position + 0.5 * velocity))
    alone = GatedAssociation()
    assert follow([(0.0, [Candidate(box_of(position))]), (0.5, [later])], alone) == [[0], [1]]
    given = GatedAssociation()
    given(0.0, [Candidate(box_of(position))])
    given.set_motion(0, CAR + position, 2.0 * velocity, CAMERA)
    assert given(0.5, [later]) == [0]
    with pytest.raises(InvalidInputError, match="identity"):
        given.set_motion(7, CAR + position, velocity, CAMERA)


def test_nothing_to_see_is_nothing():
    association = GatedAssociation()
    assert association(0.0, []) == []
    assert association(0.1, [seen_at([1.0, 1.65, 15.0])]) == [0]
    assert association(0.2, []) == []


def test_where_a_box_stands():
    place, spread = ground_contact(np.array([600.0, 150.0, 640.0, 180.0 + 720.0 * 1.65 / 20.0]), CAMERA, GROUND)
    assert place == pytest.approx([0.0, 1.65, 20.0])
    assert 0.5 < spread < 2.5
    assert ground_contact(np.array([600.0, 100.0, 640.0, 170.0]), CAMERA, GROUND) is None
    assert ground_contact(np.array([600.0, 150.0, 640.0, 374.0]), CAMERA, GROUND) is None


@pytest.mark.data
@pytest.mark.parametrize(
    ("drive", "most"),
    [("kitti_tracking_0002", 0), ("kitti_tracking_0003", 0), ("kitti_tracking_0010", 3), ("kitti_tracking_0000", 0)],
)
def test_kittis_boxes_without_their_ids(data, drive, most):
    """Of all labelled cars and vans: how often an id changes within a labelled track, seen in consecutive frames."""
    drive = read_drive(data / "kitti_video" / drive)
    association, last, switches, boxes = GatedAssociation(), {}, 0, 0
    camera = drive.calibration.camera
    for frame in drive.frames:
        kept = [i for i, kind in enumerate(frame.objects.kind) if kind in ("Car", "Van")]
        candidates = []
        for i in kept:
            box = frame.objects.box[i]
            stands = ground_contact(box, camera, GROUND)
            candidates.append(Candidate(box) if stands is None else Candidate(box, 1.0, *stands))
        ids = association(0.1 * frame.number, candidates)
        assert None not in ids
        assert len(set(ids)) == len(ids)
        for i, identity in zip(kept, ids, strict=True):
            track = int(frame.tracks[i])
            switches += last.get(track, identity) != identity
            last[track] = identity
            boxes += 1
    assert boxes > 100
    assert switches <= most, f"{switches} switches in {len(last)} tracks"


def test_births_want_evidence():
    """Of the first frame all are tracks; later ones when they are observed again soon, or beyond doubt."""
    near, other, far = (np.array([x, 1.65, z]) for x, z in ((1.0, 15.0), (-6.0, 20.0), (8.0, 40.0)))
    scenes = [(0.0, [seen_at(near, 0.6)]), (0.1, [seen_at(near, 0.6), seen_at(other, 0.7)])]
    scenes += [(0.2, [seen_at(other, 0.7), seen_at(near, 0.6)]), (0.3, [seen_at(far, 0.96)])]
    assert follow(scenes) == [[0], [0, None], [1, 0], [2]]
    late = [(0.0, []), (0.1, [seen_at(near, 0.6)]), (0.8, [seen_at(near, 0.6)]), (0.9, [seen_at(near, 0.6)])]
    assert follow(late) == [[], [None], [None], [0]]
    once = GatedAssociation(settings=AssociationSettings(birth_observations=1))
    assert follow(late, association=once) == [[], [0], [0], [0]]
