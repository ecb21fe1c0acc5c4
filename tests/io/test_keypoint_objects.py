"""Vehicles from what keypoint networks return in Python, known by what they have."""

import contextlib
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import fgrecon
from fgrecon.core.errors import FgreconError, InvalidInputError
from fgrecon.io.keypoint_file import parse_keypoints
from fgrecon.io.keypoints import keypoints_from

from .formats import CATEGORY, MISSING, VALUES, car, flat, given_by, in_scheme, our_record, same

POINTS, BOX = (values.astype(np.float32).astype(float) for values in car())
TRUST = float(np.float32(0.8))


class Tensor:
    """An array on a device."""

    def __init__(self, array):
        self.array = array

    def detach(self):
        return self

    def cpu(self):
        return self.array


def found(scale=np.asarray):
    """(1, 14, 2) pixels, zero where a point was not found, and (1, 14) confidences."""
    points, trust = POINTS[None].copy(), np.full((1, 14), TRUST)
    points[0, list(MISSING)], trust[0, list(MISSING)] = 0.0, 0.0
    return scale(points), scale(trust)


def expected(box=None, **more):
    return parse_keypoints(our_record(POINTS, TRUST, box, **more), CATEGORY).instances[0]


def results(path="a/street.jpg"):
    """What ultralytics returns for an image."""
    points, trust = found(Tensor)
    boxes = SimpleNamespace(xyxy=Tensor(BOX[None]))
    return SimpleNamespace(
        keypoints=SimpleNamespace(xy=points, conf=trust), boxes=boxes, orig_shape=(375, 1242), path=path
    )


def test_results_of_ultralytics():
    (vehicle,) = fgrecon.keypoints_from(results())
    assert (vehicle.image, vehicle.image_size) == ("street.jpg", (1242, 375))
    with pytest.raises(fgrecon.errors.InvalidInputError, match="an image of 1242 x 375 pixels"):
        fgrecon.keypoints_from(results(), image_size=(640, 640))
    same(vehicle, expected(BOX, confidence_midpoint=0.5))
    several = keypoints_from([results(), results(None)])
    assert [vehicle.name for vehicle in several] == ["0:0", "1:0"]
    assert several[1].image is None


def test_results_of_the_real_ultralytics():
    module = pytest.importorskip("ultralytics.engine.results", exc_type=ImportError)
    torch = pytest.importorskip("torch")
    points, trust = found()
    made = module.Results(
        np.zeros((375, 1242, 3), np.uint8),
        "a/street.jpg",
        {0: "car"},
        boxes=torch.tensor([[*BOX, 0.9, 0.0]]),
        keypoints=torch.tensor(np.concatenate([points, trust[..., None]], axis=2)),
    )
    (vehicle,) = keypoints_from(made)
    same(vehicle, expected(BOX.astype(np.float32).astype(float), confidence_midpoint=0.5))


def test_keypoints_of_supervision():
    points, trust = found()
    for field in ("confidence", "keypoint_confidence"):  # of older and newer versions
        (vehicle,) = keypoints_from(SimpleNamespace(xy=points, **{field: trust}))
        same(vehicle, expected())
    (vehicle,) = keypoints_from(SimpleNamespace(xy=points, confidence=None))
    assert vehicle.confidence is None


def test_what_a_mask_hides_was_not_found():
    points, trust = found()
    (visible,) = keypoints_from(SimpleNamespace(xy=points, confidence=trust))
    at = int(np.flatnonzero(visible.observation.measured)[0])
    hidden = np.ma.array(points, mask=np.zeros(points.shape, bool))
    hidden[0, at] = np.ma.masked
    (vehicle,) = keypoints_from(SimpleNamespace(xy=hidden, confidence=trust))
    assert np.flatnonzero(visible.observation.measured ^ vehicle.observation.measured).tolist() == [at]


def test_keypoints_of_the_real_supervision():
    supervision = pytest.importorskip("supervision", exc_type=ImportError)
    points, trust = found()
    try:
        made = supervision.KeyPoints(xy=points, keypoint_confidence=trust)
    except TypeError:  # versions before 0.29
        made = supervision.KeyPoints(xy=points, confidence=trust)
    (vehicle,) = keypoints_from(made)
    same(vehicle, expected())
    assert keypoints_from(supervision.KeyPoints.empty()) == ()


def test_annotations_of_openpifpaf_and_contents_of_files():
    prediction = {"keypoints": flat(in_scheme(POINTS, "apollo24"), 0.45), "bbox": [1, 2, 3, 4], "category_id": 1}
    expected = parse_keypoints(our_record(given_by("apollo24", POINTS), 0.45), CATEGORY).instances[0]
    annotation = SimpleNamespace(json_data=lambda: prediction)
    for given_ in (annotation, [annotation], prediction, [prediction]):
        (vehicle,) = keypoints_from(given_)
        same(vehicle, expected)
    assert keypoints_from([]) == ()


def test_names_of_points():
    points, trust = found()
    turned = SimpleNamespace(xy=points[:, ::-1], confidence=trust[:, ::-1])
    (vehicle,) = keypoints_from(turned, names=CATEGORY.keypoints[::-1])
    same(vehicle, expected())
    with pytest.raises(InvalidInputError, match="13 points without names"):
        keypoints_from(SimpleNamespace(xy=points[:, 1:], confidence=None))


@pytest.mark.parametrize(
    ("given_", "message"),
    [
        (SimpleNamespace(), "Give results of ultralytics"),
        (None, "Give results of ultralytics"),
        (3, "Give results of ultralytics"),
        (SimpleNamespace(xy=np.zeros((14, 2))), "xy: got shape"),
        (SimpleNamespace(xy="points"), "xy: got points. Give an array"),
        (SimpleNamespace(xy=np.ones((1, 14, 2)), confidence=np.ones(14)), "confidence: got shape"),
        (SimpleNamespace(keypoints=SimpleNamespace(xy=None), orig_shape=(1, 1)), "keypoints: got shape"),
    ],
)
def test_what_is_refused(given_, message):
    with pytest.raises(InvalidInputError, match=message):
        keypoints_from(given_)


_SHAPES = st.sampled_from([(1, 14, 2), (2, 14, 2), (1, 14), (2, 14), (1, 4), (2, 4), (0,), (0, 0), (3, 24, 2), (14,)])
_NUMBERS = st.sampled_from([0.0, 1.0, 0.5, 7, np.nan, np.inf, -1e30, "x", None])
_ARRAYS = st.builds(np.full, _SHAPES, _NUMBERS) | VALUES


@given(_ARRAYS, st.none() | _ARRAYS, st.none() | _ARRAYS)
def test_no_arrays_end_in_another_exception(xy, conf, boxes):
    whole = SimpleNamespace(
        keypoints=SimpleNamespace(xy=xy, conf=conf), boxes=SimpleNamespace(xyxy=boxes), orig_shape=(1, 1)
    )
    for given_ in (SimpleNamespace(xy=xy, confidence=conf), whole, xy):
        with contextlib.suppress(FgreconError):
            for vehicle in keypoints_from(given_):
                vehicle.observation  # noqa: B018
