"""KITTI's measures against the official evaluator's own output and against cases worked by hand."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fgrecon.calibration.labelled_boxes import MINIMUM_OVERLAP, box_overlap
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.kitti_files import Objects
from fgrecon_research.evaluation.kitti_devkit import (
    REGIMES,
    Space,
    evaluate,
    overlap,
    regime_members,
)
from fgrecon_research.io.kitti_sets import parse_objects, read_labels

SPACES = {Space.IMAGE: "detection", Space.GROUND: "detection_ground", Space.VOLUME: "detection_3d"}


def objects(*lines, scored=False):
    found, problems = parse_objects("\n".join(lines), "test", scored=scored)
    assert not [p for p in problems if p.defect != "empty file"]
    return found


def car(x, *, height=50, alpha=0.0, score=None, kind="Car", occlusion=0, truncation=0.0):
    line = f"{kind} {truncation} {occlusion} {alpha} {x} 100 {x + 80} {100 + height} 1.5 1.6 3.9 {x / 10} 1.6 20 0.0"
    return line if score is None else f"{line} {score}"


@pytest.mark.data
@pytest.mark.parametrize("name", ["good", "poor", "sparse"])
@pytest.mark.parametrize("kind", MINIMUM_OVERLAP)
def test_every_number_of_the_official_evaluator_is_met(data, name, kind):
    root = data / "kitti_devkit_output" / name
    frames = sorted(path.stem for path in (root / "data").glob("*.txt"))
    labels, _ = read_labels(data / "kitti_object" / "training" / "label_2", frames)
    results, _ = read_labels(root / "data", frames, scored=True)
    expected = json.loads((root / "expected.json").read_text())
    for space, measure in SPACES.items():
        curves = evaluate(labels, results, kind, space)
        key = f"{kind.lower()}_{measure}"
        printed = np.array([expected[key]["ap11"], expected[key]["ap40"]]).T
        np.testing.assert_allclose([c.average_precision for c in curves], printed, atol=1e-4)
        plotted = np.loadtxt(root / "curves" / f"{key}.txt")[:, 1:].T
        np.testing.assert_allclose([c.precision for c in curves], plotted, atol=1e-6)
        if space is Space.IMAGE:
            key = f"{kind.lower()}_orientation"
            printed = np.array([expected[key]["ap11"], expected[key]["ap40"]]).T
            np.testing.assert_allclose([c.orientation_similarity for c in curves], printed, atol=1e-4)
            plotted = np.loadtxt(root / "curves" / f"{key}.txt")[:, 1:].T
            np.testing.assert_allclose([c.similarity for c in curves], plotted, atol=1e-6)


def test_a_perfect_detector_by_hand():
    labels = {"a": objects(car(0), car(200)), "b": objects(car(0))}
    results = {"a": objects(car(0, score=0.9), car(200, score=0.8), scored=True)}
    results["b"] = objects(car(0, score=0.7), scored=True)
    easy = evaluate(labels, results)[0]
    # Three true positives give three thresholds, the first three of 41 samples.
    assert easy.labels == 3
    assert easy.precision.tolist() == [1.0] * 3 + [0.0] * 38
    assert easy.average_precision == pytest.approx((100 / 11, 100 * 2 / 40))


def test_orientation_similarity_by_hand():
    labels = {"a": objects(car(0, alpha=0.3))}
    results = {"a": objects(car(0, alpha=0.3 + np.pi / 2, score=0.9), scored=True)}
    easy = evaluate(labels, results)[0]
    assert easy.similarity[0] == pytest.approx(0.5)
    backwards = {"a": objects(car(0, alpha=0.3 + np.pi, score=0.9), scored=True)}
    assert evaluate(labels, backwards)[0].similarity[0] == pytest.approx(0.0)


def test_without_a_valid_alpha_there_is_no_orientation_similarity():
    found = Objects.detections(["Car"], np.array([[0.0, 100, 80, 150]]), np.array([0.9]))
    easy = evaluate({"a": objects(car(0))}, {"a": found})[0]
    assert easy.precision[0] == 1.0
    assert easy.orientation_similarity is None


@pytest.mark.parametrize("extra", ["Van 0 0 0 300 100 380 150 1.5 1.6 3.9 9 1.6 20 0.0", car(300, occlusion=3)])
def test_neighbouring_and_left_out_objects_may_be_found_without_consequence(extra):
    labels = {"a": objects(car(0), extra)}
    results = {"a": objects(car(0, score=0.5), car(300, score=0.9), scored=True)}
    assert evaluate(labels, results)[0].precision[0] == 1.0


def test_a_false_positive_counts_unless_in_a_dont_care_area_or_too_small():
    area = "DontCare -1 -1 -10 290 90 400 160 -1 -1 -1 -1000 -1000 -1000 -10"
    results = {"a": objects(car(0, score=0.5), car(300, score=0.9), scored=True)}
    assert evaluate({"a": objects(car(0))}, results)[0].precision[0] == 0.5
    assert evaluate({"a": objects(car(0), area)}, results)[0].precision[0] == 1.0
    small = {"a": objects(car(0, score=0.5), car(300, height=30, score=0.9), scored=True)}
    assert evaluate({"a": objects(car(0))}, small)[0].precision[0] == 1.0  # below 40 pixels
    assert evaluate({"a": objects(car(0))}, small)[1].precision[0] == 0.5  # but above 25


def test_a_second_detection_of_one_car_is_a_false_positive():
    results = {"a": objects(car(0, score=0.5), car(3, score=0.9), scored=True)}
    # The threshold is 0.9, that of the detection with the highest score, at which the other is not there.
    assert evaluate({"a": objects(car(0))}, results)[0].precision[0] == 1.0
    lower = {"a": objects(car(0), car(300)), "b": objects(car(0))}
    results["b"] = objects(car(0, score=0.4), scored=True)
    assert evaluate(lower, results)[0].precision[1] == pytest.approx(2 / 3)


def test_regimes_by_height_occlusion_and_truncation():
    labels = objects(
        car(0),
        car(0, height=40),
        car(0, occlusion=1),
        car(0, truncation=0.3),
        car(0, occlusion=2, truncation=0.5),
        car(0, height=25),
        car(0, occlusion=3),
    )
    members = [regime_members(labels, regime).tolist() for regime in REGIMES]
    assert members[0] == [True, False, False, False, False, False, False]
    assert members[1] == [True, True, True, True, False, False, False]
    assert members[2] == [True, True, True, True, True, False, False]


def test_results_without_labels_and_unknown_classes_are_refused():
    with pytest.raises(InvalidInputError, match="results"):
        evaluate({}, {"a": objects(scored=True)})
    with pytest.raises(InvalidInputError, match="Tram"):
        evaluate({}, {}, kind="Tram")


def test_no_detection_at_all_scores_zero():
    curves = evaluate({"a": objects(car(0))}, {"a": objects(scored=True)})
    assert [c.average_precision for c in curves] == [(0.0, 0.0)] * 3


def test_box_overlap_by_hand():
    first, second = np.array([[0.0, 0, 10, 10]]), np.array([[5.0, 0, 15, 10], [10, 10, 20, 20]])
    assert box_overlap(first, second).tolist() == [[pytest.approx(1 / 3), 0.0]]
    assert box_overlap(first, second, of_first=True).tolist() == [[0.5, 0.0]]


def test_overlaps_on_the_ground_and_in_volume_by_hand():
    a = objects("Car 0 0 0 0 0 9 9 2 2 4 0 2 20 0")
    b = objects("Car 0 0 0 0 0 9 9 2 2 4 2 1 20 0")  # 2 m along its length, 1 m higher
    assert overlap(Space.GROUND, a, b)[0, 0] == pytest.approx(4 / 12)
    assert overlap(Space.VOLUME, a, b)[0, 0] == pytest.approx(4 / (16 + 16 - 4))
    turned = objects(f"Car 0 0 0 0 0 9 9 2 2 4 0 2 20 {np.pi / 2}")
    assert overlap(Space.GROUND, a, turned)[0, 0] == pytest.approx(4 / 12)


@settings(deadline=None, max_examples=50, derandomize=True)
@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(-np.pi, np.pi), st.floats(0.5, 4), st.floats(0.5, 4))
def test_intersections_agree_with_counting_points(x, z, angle, length, width):
    rectangle = objects("Car 0 0 0 0 0 9 9 2 2 4 0 1 20 0")
    other = objects(f"Car 0 0 0 0 0 9 9 2 {width} {length} {x} 1 {20 + z} {angle}")
    grid = np.stack(np.meshgrid(np.linspace(-2, 2, 161)[:-1] + 0.0125, np.linspace(-1, 1, 81)[:-1] + 0.0125), -1)
    c, s = np.cos(angle), np.sin(angle)
    local = (grid - [x, z]) @ np.array([[c, s], [-s, c]])
    counted = (np.abs(local) <= [length / 2, width / 2]).all(axis=-1).mean() * 8.0
    shared = overlap(Space.GROUND, rectangle, other, of_first=True)[0, 0]
    assert 8.0 * shared == pytest.approx(counted, abs=0.15)
    backwards = overlap(Space.GROUND, other, rectangle, of_first=True)[0, 0]
    assert backwards * length * width == pytest.approx(8.0 * shared, abs=1e-9)
