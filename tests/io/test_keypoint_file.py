"""The reader of keypoint files: the ways to write an instance, and errors that name instance and field."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fgrecon.core.box3d import Box3D
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.catalogue import load_category
from fgrecon.io.json_fields import read_json
from fgrecon.io.keypoint_file import parse_keypoints

CATEGORY = load_category("car14")
K = [[700.0, 0.0, 600.0], [0.0, 710.0, 180.0], [0.0, 0.0, 1.0]]
POINTS = [[10.0 * i, 100.0 + i * i] for i in range(14)]


def only(data):
    (instance,) = parse_keypoints(data, CATEGORY).instances
    return instance


def test_the_least_that_an_instance_has():
    instance = only({"keypoints": POINTS})
    assert instance.name == "0"
    assert instance.keypoints.tolist() == POINTS
    unknown = (instance.confidence, instance.box, instance.covariance, instance.initial, instance.camera)
    assert unknown == (None,) * 5


def test_null_and_absent_names_are_not_found():
    listed = only({"keypoints": [*POINTS[:12], None, [None, None]]})
    named = only({"keypoints": dict(zip(CATEGORY.keypoints[:12][::-1], POINTS[:12][::-1], strict=True))})
    assert np.array_equal(listed.keypoints, named.keypoints, equal_nan=True)
    assert np.isnan(listed.keypoints[12:]).all()


def test_confidence_in_its_own_field_by_name_or_as_the_third_number():
    values = [0.05 * i for i in range(14)]
    names = CATEGORY.keypoints
    apart = only({"keypoints": POINTS, "confidence": values})
    by_name = only({"keypoints": POINTS, "confidence": dict(zip(names, values, strict=True))})
    triples = [[*point, value] for point, value in zip(POINTS, values, strict=True)]
    third = only({"keypoints": triples})
    third_by_name = only({"keypoints": dict(zip(names, triples, strict=True))})
    for instance in (apart, by_name, third, third_by_name):
        assert instance.keypoints.tolist() == POINTS
        assert instance.confidence.tolist() == values


def test_box_covariance_and_start():
    box3d = {"location": [1, 1.65, 9], "rotation_y": 0.5, "size": [4, 1.7, 1.5]}
    covariance = [[[2.0, 0.5], [0.5, 1.0]]] * 14
    instance = only({"keypoints": POINTS, "box": [1, 2, 30, 40], "covariance": covariance, "initial": box3d})
    assert instance.box.tolist() == [1, 2, 30, 40]
    assert instance.covariance.tolist() == covariance
    assert instance.observation.confidence.tolist() == [0.2] * 14  # as likely right as wrong
    assert isinstance(instance.initial, Box3D)
    assert instance.initial.size.tolist() == [4, 1.7, 1.5]
    assert only({"keypoints": POINTS, "initial": 1.25}).initial == 1.25
    assert only({"keypoints": POINTS, "initial": {**box3d, "size": None}}).initial.size is None


def test_a_list_and_an_object_with_instances():
    first, second = {"keypoints": POINTS, "id": "a"}, {"keypoints": POINTS}
    listed = parse_keypoints([first, second], CATEGORY)
    assert [instance.name for instance in listed.instances] == ["a", "1"]
    other = {"keypoints": POINTS, "intrinsics": [500, 510, 320, 240], "distortion": [0.1, 0, 0, 0]}
    shared = parse_keypoints({"K": K, "image_size": [1242, 375], "instances": [first, other]}, CATEGORY)
    cameras = [instance.camera for instance in shared.instances]
    assert cameras[0].matrix.tolist() == K
    assert cameras[0].image_size == (1242, 375)
    assert cameras[1].matrix.tolist() == [[500, 0, 320], [0, 510, 240], [0, 0, 1]]
    assert cameras[1].distortion.tolist() == [0.1, 0, 0, 0]
    assert cameras[1].image_size is None


def test_fields_without_a_meaning_are_listed():
    first, other = {"keypoints": POINTS, "weight": 1, "visible": [1.0]}, {"keypoints": POINTS, "class": 2}
    data = {"source": "x", "instances": [first, other]}
    assert parse_keypoints(data, CATEGORY).ignored == ("class", "source", "weight")


@pytest.mark.parametrize(
    ("record", "field"),
    [
        ({}, "keypoints"),
        ({"keypoints": None}, "keypoints"),
        ({"keypoints": POINTS[:13]}, "keypoints"),
        ({"keypoints": [[1.0, 2.0, 3.0, 4.0], *POINTS[1:]]}, "keypoints[0]"),
        ({"keypoints": [[1.0, 2.0, 0.5], *POINTS[1:]]}, "keypoints[1]"),
        ({"keypoints": [["1", 2.0], *POINTS[1:]]}, "keypoints[0][0]"),
        ({"keypoints": [[True, 2.0], *POINTS[1:]]}, "keypoints[0][0]"),
        ({"keypoints": {"nose": [1.0, 2.0]}}, "keypoints"),
        ({"keypoints": {"left_headlight": [1.0]}}, "keypoints.left_headlight"),
        ({"keypoints": {"left_headlight": [1.0, float("nan")]}}, "keypoints.left_headlight[1]"),
        ({"keypoints": [[*p, 0.5] for p in POINTS], "confidence": [0.5] * 14}, "confidence"),
        ({"keypoints": POINTS, "confidence": [0.5] * 15}, "confidence"),
        ({"keypoints": POINTS, "confidence": 0.5}, "confidence"),
        ({"keypoints": POINTS, "confidence_midpoint": "even"}, "confidence_midpoint"),
        ({"keypoints": POINTS, "covariance": [[1, 0, 0, 1]] * 14}, "covariance[0]"),
        ({"keypoints": POINTS, "box": [1, 2, 3]}, "box"),
        ({"keypoints": POINTS, "box": [1, 2, 3, None]}, "box[3]"),
        ({"keypoints": POINTS, "id": ["a"]}, "id"),
        ({"keypoints": POINTS, "id": ""}, "id"),
        ({"keypoints": POINTS, "initial": "left"}, "initial"),
        ({"keypoints": POINTS, "initial": {"location": [0, 0, 9]}}, "initial.rotation_y"),
        ({"keypoints": POINTS, "initial": {"location": [0, 0, -9], "rotation_y": 0}}, "initial.location"),
        ({"keypoints": POINTS, "K": K[:2]}, "K"),
        ({"keypoints": POINTS, "K": [[0, 0, 1], [0, 0, 1], [0, 0, 1]]}, "K"),
        ({"keypoints": POINTS, "intrinsics": [700, 700, 600]}, "intrinsics"),
        ({"keypoints": POINTS, "intrinsics": [700, -700, 600, 180]}, "intrinsics"),
        ({"keypoints": POINTS, "K": K, "intrinsics": [700, 700, 600, 180]}, "intrinsics"),
        ({"keypoints": POINTS, "K": K, "distortion": [0.1]}, "distortion"),
        ({"keypoints": POINTS, "K": K, "distortion": "none"}, "distortion"),
        ({"keypoints": POINTS, "distortion": [0.1, 0, 0, 0]}, "distortion"),
        ({"keypoints": POINTS, "K": K, "image_size": [1242.5, 375]}, "image_size"),
    ],
)
def test_a_malformed_instance_names_file_instance_and_field(tmp_path, record, field):
    file = tmp_path / "cars.json"
    file.write_text(json.dumps(record))
    with pytest.raises(InvalidInputError) as error:
        parse_keypoints(read_json(file), CATEGORY, where=f"{file}: ")
    assert error.value.field == f"{file}: {field}"
    file.write_text(json.dumps([{"keypoints": POINTS}, record]))
    found = parse_keypoints(read_json(file), CATEGORY, where=f"{file}: ")
    assert [one.name for one in found.instances] == ["0"], "the others are not lost with it"
    assert [one.field for one in found.left_out] == [f"{file}: instance 1: {field}"]


@pytest.mark.parametrize(
    ("data", "field"),
    [
        ([], "instances"),
        ({"instances": []}, "instances"),
        ({"instances": {}}, "instances"),
        (7, "file"),
        (["a"], "instance 0"),
        ({"K": 5, "instances": [{"keypoints": POINTS}]}, "K"),
    ],
)
def test_a_malformed_file(data, field):
    with pytest.raises(InvalidInputError) as error:
        parse_keypoints(data, CATEGORY)
    assert error.value.field == field


def test_an_id_twice_leaves_the_second_out():
    for second in ({"keypoints": POINTS}, {"keypoints": POINTS, "id": 1.0}):
        found = parse_keypoints([{"keypoints": POINTS, "id": "1"}, second], CATEGORY)
        assert [one.name for one in found.instances] == ["1"]
        assert [one.field for one in found.left_out] == ["instance 1: id"]


@pytest.mark.parametrize("content", [b"", b"{", b"\xff\xfe", b"[" * 100_000], ids=["empty", "{", "bytes", "deep"])
def test_what_is_not_json_is_refused(tmp_path, content):
    file = tmp_path / "cars.json"
    file.write_bytes(content)
    with pytest.raises(InvalidInputError, match=r"cars\.json.*Give a JSON file"):
        parse_keypoints(read_json(file), CATEGORY, where=f"{file}: ")


SCALARS = st.none() | st.booleans() | st.integers(-3, 10**400) | st.floats() | st.text(max_size=3)
KEYS = st.sampled_from(["rotation_y", "left_headlight"])
ANYTHING = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(KEYS, inner, max_size=2),
    max_leaves=8,
)
FIELDS = [
    "id",
    "keypoints",
    "confidence",
    "covariance",
    "box",
    "initial",
    "K",
    "intrinsics",
    "distortion",
    "image_size",
]


@settings(deadline=None, max_examples=300, derandomize=True)
@given(st.dictionaries(st.sampled_from(FIELDS), ANYTHING, max_size=4), st.sampled_from(["one", "list", "object"]))
def test_whatever_a_file_holds_is_read_or_refused(spoilt, form):
    record = {"keypoints": POINTS, "K": K} | spoilt
    data = {"one": record, "list": [record], "object": {"instances": [record], **spoilt}}[form]
    try:
        found = parse_keypoints(data, CATEGORY)
    except InvalidInputError:
        return
    assert found.instances[0].keypoints.shape == (14, 2)


def test_what_a_confidence_means():
    sure = only({"keypoints": POINTS, "confidence": [0.5] * 14, "confidence_midpoint": 0.5}).observation
    np.testing.assert_allclose(sure.right, 0.5)
