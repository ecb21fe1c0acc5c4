"""Masks as they are given: arrays, polygons, COCO's run lengths; their outlines and fields."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from fgrecon import Camera, Mask
from fgrecon.core.mask import joined, of_vehicle
from fgrecon.errors import InvalidInputError

SIZE = (60, 40)


def filled(x1: int = 10, y1: int = 8, x2: int = 30, y2: int = 20) -> np.ndarray:
    array = np.zeros(SIZE[::-1], dtype=bool)
    array[y1 : y2 + 1, x1 : x2 + 1] = True
    return array


def test_an_array_is_kept_as_it_is() -> None:
    mask = Mask(filled())
    assert mask.box.tolist() == [10, 8, 30, 20]
    assert mask.image_size == SIZE
    assert np.array_equal(mask.whole, filled())
    assert np.array_equal(pickle.loads(pickle.dumps(mask)).whole, filled())
    assert "273 pixels in 10, 8, 30, 20" in repr(mask)
    assert mask.hiding.hides
    assert np.array_equal(mask.hiding.whole, filled())


def test_the_field_is_the_distance_from_the_edge_between_pixels() -> None:
    distance, slope = Mask(filled()).field.at(np.array([[20.0, 8.0], [20.0, 7.0], [20.0, 5.0], [35.0, 14.0]]))
    assert distance == pytest.approx([-0.5, 0.5, 2.5, 4.5])
    assert slope[2] == pytest.approx([0.0, -1.0])
    assert slope[3] == pytest.approx([1.0, 0.0])


def test_its_farthest_points_are_on_the_edge_without_strays() -> None:
    array = filled()
    array[35, 55] = True
    corner = Mask(array).farthest(np.array([[1.0, 0.0], [0.0, 1.0]]))
    assert corner[0, 0] == pytest.approx(30.5)
    assert corner[1, 1] == pytest.approx(20.5)


def test_polygons_and_run_lengths_are_the_same_mask() -> None:
    corners = [[10, 8], [30, 8], [30, 20], [10, 20]]
    expected = filled()
    for polygons in (corners, [corners], [np.ravel(corners).tolist()], np.array(corners)):
        assert np.array_equal(Mask.of_polygons(polygons, SIZE).whole, expected)  # type: ignore[arg-type]
    columns = expected.T.ravel()
    ends = np.flatnonzero(np.diff(columns.astype(int))) + 1
    counts = np.diff([0, *ends, len(columns)]).tolist()
    assert np.array_equal(Mask.of_rle({"size": SIZE[::-1], "counts": counts}).whole, expected)
    coco = pytest.importorskip("pycocotools.mask")
    rng = np.random.default_rng(0)
    for array in (expected, rng.random(SIZE[::-1]) > 0.7, rng.random(SIZE[::-1]) > 0.02):
        packed = coco.encode(np.asfortranarray(array.astype(np.uint8)))
        for string in (packed["counts"], packed["counts"].decode()):
            assert np.array_equal(Mask.of_rle({"size": packed["size"], "counts": string}).whole, array)


def test_a_vehicle_has_the_mask_about_its_box_and_the_others_hide_it() -> None:
    own, beside, away, post = (
        Mask(filled()),
        Mask(filled(28, 8, 40, 20)),
        Mask(filled(50, 30, 55, 35)),
        filled(18, 2, 20, 30),
    )
    found, hiding = of_vehicle([beside, own, away, Mask(post, hides=True)], np.array([9.0, 8, 31, 21]), 0.3)
    assert found is own
    assert len(hiding) == 2
    assert np.array_equal(joined(hiding).whole, beside.whole | post)
    assert of_vehicle([away], np.array([9.0, 8, 31, 21]), 0.3) == (None, [])


def test_lens_distortion_is_taken_off() -> None:
    camera = Camera(np.array([[50.0, 0, 29.5], [0, 50.0, 19.5], [0, 0, 1]]), np.array([-0.2, 0.0, 0.0, 0.0]), SIZE)
    mask = Mask(filled())
    ideal = mask.undistorted(camera)
    assert ideal is not None
    corners = np.array([[10.0, 8.0], [30.0, 20.0]])
    assert ideal.box == pytest.approx(camera.undistort(corners).ravel(), abs=1.5)
    assert mask.undistorted(Camera(camera.matrix)) is mask


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: Mask(np.zeros((4, 5))), "mask"),
        (lambda: Mask(np.ones(5)), "mask"),
        (lambda: Mask(filled(), sigma=0.0), "mask.sigma"),
        (lambda: Mask.of_polygons([[1, 2], [3, 4]], SIZE), "mask.polygon"),
        (lambda: Mask.of_polygons([[1, 2], [3, np.nan], [5, 5]], SIZE), "mask.polygon"),
        (lambda: Mask.of_polygons([[1, 2, 3]], SIZE), "mask.polygon"),
        (lambda: Mask.of_polygons("abc", SIZE), "mask.polygon"),
        (lambda: Mask.of_polygons([[[1, 2], [3]], [[1, 2], [3, 4]]], SIZE), "mask.polygon"),
        (lambda: Mask.of_polygons([0, 0, 1, 0, 1, 1], (10**6, 10**6)), "mask.polygon"),
        (lambda: Mask.of_rle({"size": [10**6, 10**6], "counts": [10**12]}), "mask.rle"),
        (lambda: Mask.of_rle({"size": [4, 4], "counts": [3, 4]}), "mask.rle"),
        (lambda: Mask.of_rle({"counts": "abc"}), "mask.rle"),
        (lambda: Mask.of_rle({"size": [4, 4], "counts": "o"}), "mask.rle"),
    ],
)
def test_what_is_no_mask_is_refused(make: object, named: str) -> None:
    with pytest.raises(InvalidInputError, match=f"^{named}"):
        make()  # type: ignore[operator]
