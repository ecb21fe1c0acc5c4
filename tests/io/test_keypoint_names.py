"""Names of other programs' keypoints: shipped schemes, pairs, files, lists, and what is refused."""

import contextlib
import json
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fgrecon.core.errors import FgreconError, InvalidInputError
from fgrecon.io.catalogue import load_category, shipped_categories
from fgrecon.io.keypoints import parse_any_keypoints, shipped_schemes
from fgrecon.io.keypoints.names import naming_of, order_of, parse_names, scheme_keypoints

from .formats import CATEGORY, VALUES, car, our_record, write

POINTS, BOX = car()
PAIRS = {"fl": "left_front_wheel", "fr": "right_front_wheel", "a": "left_headlight", "b": "left_headlight"}


def test_schemes_are_whole():
    assert shipped_schemes() == ("apollo24", "apollo66", "carfusion", "pascal12")
    for scheme in shipped_schemes():
        names = parse_names(scheme, CATEGORY)
        assert len(set(names.order)) == len(names.order)
        assert {theirs for group in names.groups.values() for theirs in group} <= set(names.order)
        for ours, group in names.groups.items():  # left is left
            mirrored = CATEGORY.keypoints[CATEGORY.mirror[CATEGORY.index(ours)]]
            assert len(names.groups[mirrored]) == len(group)
            assert all(ours.partition("_")[0] in name.lower() for name in group if "glass" not in name)
        if scheme in shipped_categories():
            assert load_category(scheme).keypoints == names.order
    assert [len(scheme_keypoints(scheme)) for scheme in shipped_schemes()] == [24, 66, 14, 12]


def test_pairs_by_text_mapping_and_files(tmp_path):
    text = ",".join(f"{theirs}={ours}" for theirs, ours in PAIRS.items())
    toml = "".join(f'{theirs} = "{ours}"\n' for theirs, ours in PAIRS.items())
    ways = (text, PAIRS, write(tmp_path / "n.json", PAIRS), str(write(tmp_path / "n.toml", toml)))
    for way in ways:
        names = parse_names(way, CATEGORY)
        assert names.order is None
        assert names.groups["left_front_wheel"] == ("fl",)
        assert names.groups["left_headlight"] == ("a", "b")


def test_pairs_may_be_longer_than_a_file_name():
    pairs = ",".join(f"{'p' * 300}{k}={name}" for k, name in enumerate(CATEGORY.keypoints))
    assert len(parse_names(pairs, CATEGORY).groups) == 14
    with pytest.raises(InvalidInputError, match="Give a scheme"):
        parse_names("x" * 5000, CATEGORY)


def test_lists_by_sequence_and_files(tmp_path):
    listed = ["left_front_wheel", None, "right_front_wheel"]
    toml = 'names = ["left_front_wheel", "", "right_front_wheel"]'
    for way in (listed, tuple(listed), write(tmp_path / "n.json", listed), write(tmp_path / "n.toml", toml)):
        assert parse_names(way, CATEGORY).order == tuple(listed)


def test_a_list_in_another_schemes_names():
    names = parse_names(["rear_wheel_left", None, "front_wheel_left"], CATEGORY)
    (instance,) = parse_any_keypoints(
        {"keypoints": [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]},
        CATEGORY,
        names=["rear_wheel_left", None, "front_wheel_left"],
    ).instances
    assert names.groups["left_back_wheel"] == ("rear_wheel_left",)
    assert instance.keypoints[2].tolist() == [1, 2]
    assert instance.keypoints[0].tolist() == [5, 6]


def test_the_centre_of_several_points():
    points = {"fl": [1.0, 2.0, 0.5], "a": [10.0, 20.0, 0.4], "b": [20.0, 40.0, 0.6], "other": [0, 0, 1]}
    file = parse_any_keypoints({"keypoints": points}, CATEGORY, names=PAIRS)
    (instance,) = file.instances
    assert instance.keypoints[CATEGORY.index("left_headlight")].tolist() == [15, 30]
    assert instance.confidence[CATEGORY.index("left_headlight")] == 0.5
    assert np.isfinite(instance.keypoints[:, 0]).sum() == 2
    assert file.ignored == ("keypoint other",)
    del points["b"]
    (instance,) = parse_any_keypoints({"keypoints": points}, CATEGORY, names=PAIRS).instances
    assert np.isnan(instance.keypoints[CATEGORY.index("left_headlight")]).all()


def test_a_typing_error_loses_no_other_keypoint_and_is_said():
    points = {"left_front_wheel": [1.0, 2.0], "left_fornt_roof": [3.0, 4.0], "antenna": [5.0, 6.0]}
    found = parse_any_keypoints({"keypoints": points}, CATEGORY)
    (error,) = found.unknown
    assert error.field == "keypoints"
    assert re.search(r"left_fornt_roof, antenna\..*by `names` \(--names\)", str(error))
    assert found.instances[0].keypoints[CATEGORY.index("left_front_wheel")].tolist() == [1, 2]
    with pytest.raises(InvalidInputError, match="antenna"):
        parse_any_keypoints({"keypoints": {"antenna": [5.0, 6.0]}}, CATEGORY)
    (instance,) = parse_any_keypoints([{"keypoints": points}], CATEGORY, "left_fornt_roof=left_front_roof").instances
    assert instance.keypoints[CATEGORY.index("left_front_roof")].tolist() == [3, 4]
    assert instance.keypoints[CATEGORY.index("left_front_wheel")].tolist() == [1, 2]


def test_points_without_names_are_called_by_their_numbers():
    flat = [{"keypoints": [1, 2, 0.5, 3, 4, 0.5, 5, 6, 0.5]}]
    (instance,) = parse_any_keypoints(flat, CATEGORY, names="2=left_front_wheel,0=right_back_wheel").instances
    assert instance.keypoints[0].tolist() == [5, 6]
    assert instance.keypoints[3].tolist() == [1, 2]


def test_capital_letters_make_no_difference():
    names = naming_of(["Left_Front_Headlight", "Right_Front_wheel", "exhaust"], CATEGORY)
    assert names.groups["left_headlight"] == ("Left_Front_Headlight",)
    assert naming_of(["nose", "left_eye"], CATEGORY) is None


def test_an_order_that_nobody_knows():
    assert order_of(24, CATEGORY, None, "f") == scheme_keypoints("apollo24")
    assert order_of(14, CATEGORY, None, "f") == CATEGORY.keypoints
    assert order_of(14, CATEGORY, parse_names("carfusion", CATEGORY), "f") == scheme_keypoints("carfusion")
    with pytest.raises(InvalidInputError, match="17 points without names"):
        order_of(17, CATEGORY, None, "f")
    with pytest.raises(InvalidInputError, match=r"\(--names\) says 24"):
        order_of(17, CATEGORY, parse_names("apollo24", CATEGORY), "f")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("nonsense", "names: got nonsense. Give a scheme"),
        ("a=left_front_wheel,a=right_front_wheel", "each point once"),
        ("a=", "Give pairs"),
        ("a=left_wheel", "names: a: got left_wheel"),
        ({"a": 3}, "names: a: got 3"),
        ({}, "Give a scheme"),
        (["left_front_wheel", 3], r"names\[1\]: got 3"),
        (["left_front_wheel"] * 2, "distinct names"),
        (["nose", "eye"], "Use names of car14"),
        (7, "Give a scheme"),
    ],
)
def test_what_is_refused(given, message):
    with pytest.raises(InvalidInputError, match=message):
        parse_names(given, CATEGORY)


def test_a_scheme_for_another_category():
    with pytest.raises(InvalidInputError, match="known for car14"):
        parse_names("carfusion", load_category("car36"))


@pytest.mark.parametrize(
    ("name", "content"), [("n.toml", "= 3"), ("n.json", "{"), ("n.json", "3"), ("n.toml", "a = 3")]
)
def test_malformed_files(tmp_path, name, content):
    path = write(tmp_path / name, content)
    with pytest.raises(InvalidInputError, match=name):
        parse_names(path, CATEGORY)
    with pytest.raises(InvalidInputError, match=r"none\.toml"):
        parse_names(tmp_path / "none.toml", CATEGORY)


@given(VALUES | st.text("ab=,left_fronwh", max_size=30), VALUES)
def test_no_names_end_in_another_exception(names, points):
    record = our_record(POINTS, 0.5, BOX) | {"keypoints": points}
    with contextlib.suppress(FgreconError):
        parse_any_keypoints(json.loads(json.dumps(record)), CATEGORY, names=names)
