"""Keypoints in other programs' files: read and solved as the same data in fgrecon's own layout."""

import contextlib
import json

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fgrecon.core.errors import FgreconError, InvalidInputError
from fgrecon.io.catalogue import load_category
from fgrecon.io.keypoint_file import parse_keypoints
from fgrecon.io.keypoints import parse_any_keypoints, read_any_keypoints
from fgrecon.io.keypoints.names import scheme_keypoints

from .formats import CATEGORY, MISSING, car, flat, given_by, in_scheme, our_record, pascal_file, same, spoilt, write

POINTS, BOX = car()
BBOX = [float(x) for x in (BOX[0], BOX[1], BOX[2] - BOX[0], BOX[3] - BOX[1])]
CORNERS = [*BBOX[:2], BBOX[0] + BBOX[2], BBOX[1] + BBOX[3]]


def ours(*records):
    return parse_keypoints(list(records), CATEGORY).instances


def coco(keypoints, names=CATEGORY.keypoints, **more):
    """COCO's annotations: two images, of which the second has a crowd and an instance without a label as well."""
    nothing = [0] * len(keypoints)
    return {
        "info": {"description": "cars"},
        "images": [
            {"id": 1, "file_name": "a/street.jpg", "width": 1242, "height": 375},
            {"id": 2, "file_name": "a/other.jpg", "width": 1242, "height": 375},
        ],
        "categories": [{"id": 7, "name": "dog"}, {"id": 3, "name": "car", "keypoints": list(names), "skeleton": []}],
        "annotations": [
            {"id": 11, "image_id": 1, "category_id": 3, "bbox": BBOX, "keypoints": keypoints, "iscrowd": 0, **more},
            {"id": 12, "image_id": 2, "category_id": 3, "bbox": BBOX, "keypoints": nothing, "iscrowd": 0},
            {"id": 13, "image_id": 2, "category_id": 3, "bbox": BBOX, "keypoints": keypoints, "iscrowd": 1},
            {"id": 14, "image_id": 2, "category_id": 7, "bbox": BBOX},
            {"id": 15, "image_id": 2, "category_id": 3, "bbox": BBOX, "keypoints": keypoints},
        ],
    }


def labelled(flag=2):
    """Flat keypoints with a flag."""
    return flat(np.where(np.isin(np.arange(14), MISSING)[:, None], np.nan, POINTS), flag)


def test_coco_annotations(tmp_path):
    file = read_any_keypoints(write(tmp_path / "c.json", coco(labelled())), CATEGORY)
    assert [(instance.name, instance.image) for instance in file.instances] == [
        ("11", "a/street.jpg"),
        ("15", "a/other.jpg"),
    ]
    (expected,) = ours(our_record(POINTS, 1.0, CORNERS))
    same(file.instances[0], expected)


def test_coco_annotations_without_a_keypoint_are_left_out_and_counted():
    content = coco(labelled())
    content["annotations"].append({"id": 16, "image_id": 1, "category_id": 3, "bbox": BBOX, "iscrowd": 0})
    file = parse_any_keypoints(content, CATEGORY)
    assert len(file.instances) == 2
    (left_out,) = file.left_out
    assert str(left_out).startswith("annotations[1].keypoints: got 2 without a labelled one.")


def test_coco_as_its_own_library_writes_it(tmp_path):
    library = pytest.importorskip("pycocotools.coco")
    path = write(tmp_path / "c.json", coco(labelled()))
    with contextlib.redirect_stdout(None):
        index = library.COCO(str(path))
    (annotation,) = index.loadAnns([11])
    (instance, _) = read_any_keypoints(path, CATEGORY).instances
    theirs = np.array(annotation["keypoints"]).reshape(-1, 3)
    assert np.array_equal(instance.keypoints[theirs[:, 2] > 0], theirs[theirs[:, 2] > 0, :2])


def test_hidden_labels_are_as_likely_right_as_wrong():
    keypoints = labelled()
    keypoints[2] = 1
    (instance, _) = parse_any_keypoints(coco(keypoints), CATEGORY).instances
    assert instance.confidence[0] == 0.2
    assert set(instance.confidence[1:][np.isfinite(instance.confidence[1:])]) == {1.0}


def test_the_vehicles_of_one_photograph():
    for image in ("street.png", "street"):
        (instance,) = parse_any_keypoints(coco(labelled()), CATEGORY, image=image).instances
        assert instance.name == "11"
    with pytest.raises(InvalidInputError, match=r"such as a/other\.jpg"):
        parse_any_keypoints(coco(labelled()), CATEGORY, image="third.png")


def test_coco_results_are_distinguished_by_their_image():
    result = {"image_id": 7, "category_id": 3, "score": 0.9, "bbox": BBOX, "keypoints": labelled(0.6)}
    file = parse_any_keypoints([result, {**result, "image_id": 8}], CATEGORY, image="000008.png")
    (expected,) = ours(our_record(POINTS, 0.6, CORNERS))
    (instance,) = file.instances
    same(instance, expected)
    assert instance.name == "1"


@pytest.mark.parametrize("scheme", ["apollo24", "apollo66"])
def test_openpifpaf_predictions(tmp_path, scheme):
    points = in_scheme(POINTS, scheme)
    prediction = {"keypoints": flat(points, 0.45), "bbox": [1.0, 2.0, 30.0, 40.0], "score": 0.7, "category_id": 1}
    file = read_any_keypoints(write(tmp_path / "p.json", [prediction]), CATEGORY)
    assert file.ignored == ()
    (expected,) = ours(our_record(given_by(scheme, POINTS), 0.45))
    same(file.instances[0], expected)  # without the box, which is that of the points
    if scheme == "apollo24":
        assert np.isfinite(file.instances[0].keypoints[:, 0]).sum() == 14 - len(MISSING)


def test_a_lamp_of_which_a_corner_is_not_found_is_not_found():
    values = flat(in_scheme(POINTS, "apollo66"), 0.45)
    corner = scheme_keypoints("apollo66").index("top_left_c_left_front_car_light")
    values[3 * corner : 3 * corner + 3] = [0, 0, 0]
    (instance,) = parse_any_keypoints([{"keypoints": values}], CATEGORY).instances
    assert np.isnan(instance.keypoints[CATEGORY.index("left_headlight")]).all()
    assert np.isfinite(instance.keypoints[CATEGORY.index("right_headlight")]).all()


def test_a_foreign_category_takes_all_points():
    category = load_category("apollo24")
    values = flat(in_scheme(POINTS, "apollo24"), 0.45)
    (instance,) = parse_any_keypoints([{"keypoints": values}], category).instances
    expected = np.array(values).reshape(-1, 3)
    seen = expected[:, 2] > 0
    assert np.array_equal(instance.keypoints[seen], expected[seen, :2])
    assert np.isnan(instance.keypoints[~seen]).all()


def test_carfusion(tmp_path):
    points = in_scheme(POINTS, "carfusion")
    seen = np.flatnonzero(np.isfinite(points[:, 0]))
    lines = [f"{points[i, 0]:.2f},{points[i, 1]:.2f},{i + 1},{c},1" for c in (4, 9) for i in seen]
    file = read_any_keypoints(write(tmp_path / "1_0007.txt", "\n".join([*lines, "-3,-2,9,9,1", ""])), CATEGORY)
    assert [(instance.name, instance.image) for instance in file.instances] == [
        ("4", "1_0007.jpg"),
        ("9", "1_0007.jpg"),
    ]
    (expected,) = ours(our_record(given_by("carfusion", POINTS), 1.0))
    for instance in file.instances:
        same(instance, expected)


def test_carfusion_in_coco_whose_names_are_numbers():
    """As the data set's own conversion writes it."""
    names = [str(number) for number in range(14)]
    content = coco(flat(in_scheme(POINTS, "carfusion"), 2), names)
    with pytest.raises(InvalidInputError, match="--names"):
        parse_any_keypoints(content, CATEGORY)
    (instance, _) = parse_any_keypoints(content, CATEGORY, names="carfusion").instances
    (expected,) = ours(our_record(given_by("carfusion", POINTS), 1.0, CORNERS))
    same(instance, expected)


def test_pascal3d(tmp_path):
    pascal_file(tmp_path / "2008_000001.mat", POINTS, BOX)
    (instance,) = read_any_keypoints(tmp_path / "2008_000001.mat", CATEGORY).instances
    assert instance.image == "2008_000001.jpg"
    assert np.allclose(instance.box, BOX)
    (expected,) = ours(our_record(given_by("pascal12", POINTS), 0.2))
    measured = np.isfinite(expected.keypoints)
    assert np.allclose(instance.keypoints[measured], expected.keypoints[measured])
    assert np.isnan(instance.keypoints[~measured]).all()


def test_our_layout_with_their_names(tmp_path):
    by_name = dict(zip(scheme_keypoints("apollo24"), in_scheme(POINTS, "apollo24").tolist(), strict=True))
    seen = {name: point for name, point in by_name.items() if np.isfinite(point[0])}
    rows = [[*point, 0.4] if np.isfinite(point[0]) else None for point in by_name.values()]
    trust = dict.fromkeys(seen, 0.4)
    expected = ours(our_record(given_by("apollo24", POINTS), 0.4, BOX))
    for record in (
        {"keypoints": seen, "confidence": trust},
        {"keypoints": rows},
        {"keypoints": dict(zip(by_name, rows, strict=True))},
    ):
        (instance,) = parse_any_keypoints([record | {"box": BOX.tolist()}], CATEGORY).instances
        same(instance, expected[0])


def test_what_fgrecon_labels_say_beside_cocos_fields():
    extra = {
        "keypoint_probability": [0.9] * 14,
        "keypoint_covariance": [[[4.0, 0.0], [0.0, 3.0]]] * 14,
    }
    content = coco(labelled(), **extra)
    content["images"][0]["camera_matrix"] = [[700, 0, 600], [0, 710, 180], [0, 0, 1]]
    (instance, _) = parse_any_keypoints(content, CATEGORY).instances
    assert instance.confidence_midpoint == 0.5
    assert instance.camera.image_size == (1242, 375)
    seen = np.isfinite(instance.keypoints[:, 0])
    assert seen.sum() == 14 - len(MISSING)
    assert (instance.confidence[seen] == 0.9).all()
    assert (instance.covariance[seen] == [[4, 0], [0, 3]]).all()


SPOILT = coco(labelled(), keypoint_probability=[0.9] * 14)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        (lambda c: c["annotations"][0]["keypoints"].pop(), r"annotations\[0\]\.keypoints: got 41 numbers"),
        (lambda c: c["annotations"][0].update(bbox=[1, 2, 3]), r"annotations\[0\]\.bbox: got 3 elements"),
        (lambda c: c["annotations"][0].update(category_id="car"), r"annotations\[0\]\.category_id: got car"),
        (lambda c: c["annotations"][0]["keypoints"].__setitem__(2, 5), r"keypoints: got 5.0. Let every third"),
        (lambda c: c["categories"].pop(), "categories: got no keypoint names"),
        (lambda c: c["categories"][1].update(keypoints=["a"] * 14), "Give a list of distinct names"),
        (
            lambda c: c["categories"][1].update(keypoints=[f"p{i}" for i in range(14)]),
            r"Say by `names` \(--names\) which",
        ),
        (lambda c: c["images"][0].pop("id"), r"images\[0\]\.id: got nothing"),
        (lambda c: c["annotations"].clear(), "keypoints: got no labelled keypoint"),
    ],
)
def test_malformed_coco_is_one_line(tmp_path, change, field):
    content = json.loads(json.dumps(SPOILT))
    del content["annotations"][1:]  # the others of a file are not lost with one
    change(content)
    path = write(tmp_path / "c.json", content)
    with pytest.raises(InvalidInputError, match=field) as caught:
        read_any_keypoints(path, CATEGORY)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_a_malformed_annotation_leaves_the_others():
    content = json.loads(json.dumps(SPOILT))
    content["annotations"].append(json.loads(json.dumps(content["annotations"][0])) | {"id": 77})
    content["annotations"][0]["keypoints"].pop()
    found = parse_any_keypoints(content, CATEGORY)
    assert "77" in [one.name for one in found.instances]
    assert "annotations[0].keypoints" in [error.field for error in found.left_out]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("1,2,3,4", ":1: got 1,2,3,4. Give `u, v"),
        ("1,2,15,4,1", "keypoint 1 to 14"),
        ("1,2,3,4,1\nx,2,3,4,1", ":2: got x"),
        ("1,2,3,4,7", "visibility 1, 2 or 3"),
        ("1,2,3.5,4,1", ":1"),
        ("inf,2,3,4,1", ":1"),
        ("", "no point"),
        ("-1,-1,3,4,1", "no point"),
    ],
)
def test_malformed_carfusion_is_one_line(tmp_path, content, message):
    with pytest.raises(InvalidInputError) as caught:
        read_any_keypoints(write(tmp_path / "a.txt", content), CATEGORY)
    assert message in str(caught.value)


def test_files_that_cannot_be_read(tmp_path):
    (tmp_path / "b.txt").write_bytes(b"\xff\xfe\x00")
    for name in ("none.txt", "none.json", "none.mat", "b.txt"):
        with pytest.raises(InvalidInputError, match=name):
            read_any_keypoints(tmp_path / name, CATEGORY)


FUZZ = settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.too_slow])
PREDICTIONS = [{"keypoints": flat(in_scheme(POINTS, "apollo24"), 0.4), "bbox": BBOX, "score": 0.5, "category_id": 1}]


@FUZZ
@given(spoilt(SPOILT) | spoilt(PREDICTIONS) | spoilt([our_record(in_scheme(POINTS, "apollo24")[:14], 0.4, BOX)]))
def test_no_json_ends_in_another_exception(content):
    with contextlib.suppress(FgreconError):
        for instance in parse_any_keypoints(content, CATEGORY).instances:
            instance.observation  # noqa: B018


@FUZZ
@given(st.lists(st.text("0123456789.,-einfa \n", max_size=12), max_size=4))
def test_no_text_ends_in_another_exception(tmp_path_factory, lines):
    path = tmp_path_factory.getbasetemp() / "fuzz.txt"
    with contextlib.suppress(FgreconError):
        read_any_keypoints(write(path, "\n".join(lines)), CATEGORY)


def test_the_size_of_the_image_that_coco_states():
    content = coco(labelled())
    (instance, _) = parse_any_keypoints(content, CATEGORY).instances
    assert (instance.image_size, instance.kind) == ((1242, 375), "car")
    assert instance.fitted((1242, 375)) is instance.fitted(None) is instance
    with pytest.raises(InvalidInputError, match=r"1242 x 375 pixels.*2484 x 750 pixels.*scale_to_image"):
        instance.fitted((2484, 750))
    twice = instance.fitted((2484, 750), scale=True)
    np.testing.assert_allclose(twice.keypoints, 2 * instance.keypoints + 0.5)
    np.testing.assert_allclose(twice.box, 2 * instance.box)
    with pytest.raises(InvalidInputError, match=r"1242 x 375 pixels.*640 x 640"):
        instance.fitted((640, 640), scale=True)


@pytest.mark.parametrize("number", [1.0, "1"])
def test_ids_of_coco_are_alike_whatever_way_they_are_written(number):
    content = coco(labelled())
    content["images"][0]["id"] = content["annotations"][0]["image_id"] = number
    content["annotations"][0] |= {"category_id": 3.0, "id": 11.0, "score": 0.5, "track_id": 4}
    instance = parse_any_keypoints(content, CATEGORY).instances[0]
    assert (instance.name, instance.image, instance.score, instance.track) == ("11", "a/street.jpg", 0.5, 4)
