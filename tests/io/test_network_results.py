"""Vehicles from what networks' libraries return, and what they write as JSON: classes, scores and tracks are kept."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

import fgrecon
from fgrecon.batch.inputs import sources_of
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.images import write_png
from fgrecon.io.keypoints import read_any_keypoints

from .formats import CATEGORY, MISSING, car

POINTS, BOX = car()
NAMES = CATEGORY.keypoints
THERE = [name for i, name in enumerate(NAMES) if i not in MISSING]


def arrays():
    """(1, 14, 2) pixels and (1, 14) confidences, zero where a point was not found."""
    points, trust = POINTS[None].copy(), np.full((1, 14), 0.8)
    points[0, list(MISSING)], trust[0, list(MISSING)] = 0.0, 0.0
    return points, trust


def check(vehicle, *, kind="car", score=0.9, track=None, midpoint=0.5, box=True, off=1e-4):
    observation = vehicle.observation
    assert [NAMES[i] for i in np.flatnonzero(observation.measured)] == THERE
    assert np.abs(observation.keypoints[observation.measured] - POINTS[observation.measured]).max() < off
    assert np.allclose(observation.confidence[observation.measured], 0.8)
    assert observation.confidence_midpoint == midpoint
    assert (vehicle.kind, vehicle.track) == (kind, track)
    assert vehicle.score == pytest.approx(score)
    if box:
        assert np.abs(observation.box - BOX).max() < off


def test_ultralytics_keeps_class_score_and_track():
    points, trust = arrays()
    boxes = SimpleNamespace(xyxy=BOX[None], conf=np.array([0.9]), cls=np.array([2.0]), id=np.array([7.0]))
    found = SimpleNamespace(
        keypoints=SimpleNamespace(xy=points, conf=trust), boxes=boxes, orig_shape=(9, 9), path="a.jpg", names={2: "car"}
    )
    (vehicle,) = fgrecon.keypoints_from(found)
    check(vehicle, track=7)


def test_supervision_keeps_class_and_score():
    points, trust = arrays()
    found = SimpleNamespace(
        xy=points,
        keypoint_confidence=trust,
        detection_confidence=np.array([0.9]),
        data={"class_name": np.array(["car"])},
    )
    (vehicle,) = fgrecon.keypoints_from(found)
    check(vehicle, midpoint=0.2, box=False)


def test_mmpose_samples():
    points, trust = arrays()
    found = SimpleNamespace(keypoints=points, keypoint_scores=trust, bboxes=BOX[None], bbox_scores=np.array([0.9]))
    (vehicle,) = fgrecon.keypoints_from(SimpleNamespace(pred_instances=found))
    check(vehicle, kind=None, midpoint=0.2)


def test_torchvision_scores_are_heights_of_a_heat_map():
    points, trust = arrays()
    height = np.full((1, 14), np.log(4.0))  # 0.8
    third = np.ones((1, 14, 1))
    points[0, list(MISSING)] = 0.0
    given = {"keypoints": np.concatenate([points, third], axis=2), "keypoints_scores": height}
    (vehicle,) = fgrecon.keypoints_from(given | {"boxes": BOX[None], "scores": np.array([0.9])})
    check(vehicle, kind=None)
    assert len(fgrecon.keypoints_from([given, given])) == 2
    assert trust.shape == height.shape


def test_detectron2_instances():
    points, trust = arrays()
    found = SimpleNamespace(
        pred_keypoints=np.concatenate([points, trust[..., None]], axis=2),
        pred_boxes=SimpleNamespace(tensor=BOX[None]),
        scores=np.array([0.9]),
    )
    for given in (found, {"instances": found}):
        (vehicle,) = fgrecon.keypoints_from(given)
        check(vehicle, kind=None, midpoint=0.05)


def summary():
    """What ultralytics' `summary()` gives (8.4.190)."""
    points, trust = arrays()
    box = dict(zip(("x1", "y1", "x2", "y2"), BOX.tolist(), strict=True))
    columns = {"x": points[0, :, 0].tolist(), "y": points[0, :, 1].tolist(), "visible": trust[0].tolist()}
    return [{"name": "car", "class": 2, "confidence": 0.9, "box": box, "track_id": 7, "keypoints": columns}]


def roboflow():
    """What Roboflow's inference answers (1.8.3)."""
    low, high = BOX[:2], BOX[2:]
    points = [
        {"x": u, "y": v, "confidence": 0.8, "class_id": i, "class": NAMES[i]}
        for i, (u, v) in enumerate(POINTS.tolist())
        if i not in MISSING
    ]
    centre = dict(zip("xy", ((low + high) / 2).tolist(), strict=True))
    size = dict(zip(("width", "height"), (high - low).tolist(), strict=True))
    one = {**centre, **size, "confidence": 0.9, "class": "car", "class_id": 2, "detection_id": "x", "keypoints": points}
    return {"image": {"width": 9, "height": 9}, "predictions": [one]}


def mmpose():
    """What MMPose's inferencer writes (1.3.2): a list of one box."""
    points, trust = arrays()
    one = {
        "keypoints": points[0].tolist(),
        "keypoint_scores": trust[0].tolist(),
        "bbox": [BOX.tolist()],
        "bbox_score": 0.9,
    }
    return {"predictions": [[one]]}


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (summary(), {"track": 7}),
        (summary()[0], {"track": 7}),
        (roboflow(), {}),
        (mmpose(), {"kind": None, "midpoint": 0.2}),
        (mmpose()["predictions"][0], {"kind": None, "midpoint": 0.2}),
    ],
)
def test_json_of_networks(tmp_path, content, expected):
    (vehicle,) = fgrecon.keypoints_from(content)
    check(vehicle, **expected)
    path = tmp_path / "found.json"
    path.write_text(json.dumps(content))
    (vehicle,) = read_any_keypoints(path, CATEGORY).instances
    check(vehicle, **expected)
    (source,) = sources_of([path])
    assert source.count() == 1
    (row,) = source.rows()
    (vehicle,) = fgrecon.keypoints_from(json.loads(row["instance"]))
    check(vehicle, **expected)


def test_what_is_malformed_is_named():
    bad = summary()
    bad[0]["keypoints"]["y"] = bad[0]["keypoints"]["y"][:-1]
    with pytest.raises(InvalidInputError, match=r"\[0\]\.keypoints\.y"):
        fgrecon.keypoints_from(bad)
    bad = roboflow()
    bad["predictions"][0]["keypoints"][1]["x"] = "left"
    with pytest.raises(InvalidInputError, match=r"\[0\]\.keypoints\[1\]\.x"):
        fgrecon.keypoints_from(bad)
    points, trust = arrays()
    found = SimpleNamespace(keypoints=points, keypoint_scores=trust, bboxes=BOX[None], bbox_scores=np.array([0.9, 0.8]))
    with pytest.raises(InvalidInputError, match="scores"):
        fgrecon.keypoints_from(SimpleNamespace(pred_instances=found))


def test_an_object_of_norfair_is_a_vehicle_without_the_points_that_are_lost():
    points, trust = arrays()
    points[0, list(MISSING)] = 5.0  # where they were last
    alive = trust[0] > 0
    found = [SimpleNamespace(estimate=points[0], live_points=alive, id=number, label="car") for number in (3, None)]
    vehicles = fgrecon.keypoints_from(found)
    assert [(vehicle.track, vehicle.kind) for vehicle in vehicles] == [(3, "car"), (None, "car")]
    for vehicle in vehicles:
        assert [NAMES[i] for i in np.flatnonzero(vehicle.observation.measured)] == THERE


def yolo(size, *, trust=("0.8", "0"), behind="", each=3):
    """A line of YOLO's, whose numbers are shares of an image of a size."""
    width, height = size
    x1, y1, x2, y2 = BOX.tolist()
    box = [(x1 + x2) / 2 / width, (y1 + y2) / 2 / height, (x2 - x1) / width, (y2 - y1) / height]
    words = ["2", *map(str, box)]
    for i, (u, v) in enumerate(POINTS.tolist()):
        gone = i in MISSING
        words += ["0", "0"] if gone else [str(u / width), str(v / height)]
        words += [trust[gone]] if each == 3 else []
    return " ".join([*words, behind])


@pytest.mark.parametrize("folder", [".", "labels/train"])
@pytest.mark.parametrize(
    ("behind", "score", "track"), [("", None, None), ("0.9 7", 0.9, 7), ("7", None, 7), ("0.9", 0.9, None)]
)
def test_lines_of_yolo(tmp_path, folder, behind, score, track):
    size = (1242, 375)
    path = tmp_path / folder / "street.txt"
    picture = tmp_path / folder.replace("labels", "images") / "street.png"
    for file in (path, picture):
        file.parent.mkdir(parents=True, exist_ok=True)
    write_png(picture, np.zeros((*size[::-1], 3), np.uint8))
    path.write_text(f"{yolo(size, behind=behind)}\n\n{yolo(size, behind=behind)}\n")
    first, second = read_any_keypoints(path, CATEGORY).instances
    check(first, kind=None, score=score, track=track)
    assert (first.image, second.name) == ("street.png", "3")
    (source,) = sources_of([path])
    assert len(list(source.rows())) == 2


def test_flags_and_points_of_two_numbers(tmp_path):
    size = (1242, 375)
    write_png(tmp_path / "street.png", np.zeros((*size[::-1], 3), np.uint8))
    path = tmp_path / "street.txt"
    for line, sure in (
        (yolo(size, trust=("2", "0")), 1.0),
        (yolo(size, trust=("1", "0")), None),
        (yolo(size, each=2), 1.0),
    ):
        path.write_text(line)
        ((observation,),) = [[one.observation for one in read_any_keypoints(path, CATEGORY).instances]]
        assert [NAMES[i] for i in np.flatnonzero(observation.measured)] == THERE
        expected = observation.confidence_midpoint if sure is None else sure
        assert np.allclose(observation.confidence[observation.measured], expected)
        assert np.abs(observation.keypoints[observation.measured] - POINTS[observation.measured]).max() < 1e-9
    path.write_text("2 0.5 0.5 x")
    with pytest.raises(InvalidInputError, match=r"street\.txt:1.*14 points"):
        read_any_keypoints(path, CATEGORY)
    (tmp_path / "street.png").unlink()
    with pytest.raises(InvalidInputError, match=r"without its image.*street\.jpg"):
        read_any_keypoints(path, CATEGORY)
