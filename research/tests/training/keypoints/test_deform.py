"""Displacement fields: what they move, and that points stay on what they mark."""

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from fgrecon.io.catalogue import load_prior
from fgrecon_research.training.keypoints.augment import Street
from fgrecon_research.training.keypoints.deform import deform, deform_points, move_points, random_field
from research.tests.training.keypoints.test_augment import MIRROR, PLAIN, made_up_view

SIDE = 96


def dotted(points):
    """A black image with a bright dot at each point."""
    row, column = np.mgrid[:SIDE, :SIDE]
    image = sum(np.exp(-((column - u) ** 2 + (row - v) ** 2) / 4.0) for u, v in points)
    return np.clip(255 * image, 0, 255).astype(np.uint8)


def folds(field):
    """Whether some place in the image is shown twice: the map p + field(p) turns over."""
    dy, dx = (np.gradient(field, axis=axis) for axis in (0, 1))
    return bool(((1 + dx[..., 0]) * (1 + dy[..., 1]) - dx[..., 1] * dy[..., 0] <= 0).any())


def test_no_field_changes_nothing():
    image = dotted([(20, 30), (70, 55)])
    field = np.zeros((SIDE, SIDE, 2), dtype=np.float32)
    np.testing.assert_array_equal(deform(image, field), image)
    np.testing.assert_allclose(deform_points(np.array([[20.0, 30.0]]), field), [[20.0, 30.0]])


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), spread=st.floats(0.0, 2.5))
def test_points_go_with_the_image(seed, spread):
    rng = np.random.default_rng(seed)
    point = rng.uniform(20, SIDE - 20, (1, 2))
    field = random_field(SIDE, spread, rng)
    image = deform(dotted(point), field).astype(float)
    row, column = np.mgrid[:SIDE, :SIDE]
    found = np.array([(image * column).sum(), (image * row).sum()]) / image.sum()
    np.testing.assert_allclose(deform_points(point, field)[0], found, atol=0.6)


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 10_000), far=st.floats(0.0, 40.0))
def test_no_image_is_folded(seed, far):
    rng = np.random.default_rng(seed)
    points = rng.uniform(10, SIDE - 10, (14, 2))
    by = np.zeros_like(points)
    by[rng.integers(14)] = rng.normal(0.0, far, 2)
    assert not folds(move_points(SIDE, points, by))


def test_a_point_moves_where_it_is_sent_and_others_stay():
    points = np.array([[25.0, 25.0], [70.0, 25.0], [25.0, 75.0], [70.0, 75.0], [np.nan, np.nan]])
    by = np.array([[8.0, 3.0], *[[0.0, 0.0]] * 4])
    moved = deform_points(points, move_points(SIDE, points, by))
    np.testing.assert_allclose(moved[0], points[0] + by[0], atol=1.0)
    np.testing.assert_allclose(moved[1:4], points[1:4], atol=1.0)
    assert np.isnan(moved[4]).all()


def test_sides_of_faces_are_what_moves():
    prior = load_prior("car14")
    category = prior.category
    name = {name: number for number, name in enumerate(category.keypoints)}
    moves = Street().shaping(prior).moves
    assert (name["left_back_roof"], name["left_front_roof"]) in moves
    assert (name["right_front_roof"], name["right_back_roof"]) in moves
    assert not {k for pair in moves for k in pair} & {k for k, n in enumerate(category.keypoints) if "wheel" in n}


def test_a_pair_of_parts_moves_towards_another_by_the_same_share():
    view = made_up_view(np.random.default_rng(0))
    above = view.keypoints[:, 1] > view.image.shape[0] / 2
    view = replace(view, keypoints=view.keypoints[np.lexsort((view.keypoints[:, 0], above))])
    still = replace(PLAIN, stretch=0.0, bend=0.0)
    moving = replace(still, moved=1.0, moves=((12, 10),))
    ratios = []
    for seed in range(20):
        before, after = (s.sample(view, lambda _: view, MIRROR, np.random.default_rng(seed)) for s in (still, moving))
        ratios.append(
            [
                np.linalg.norm(np.subtract(*after.keypoints[list(pair)]))
                / np.linalg.norm(np.subtract(*before.keypoints[list(pair)]))
                for pair in ((12, 10), (13, 11))
            ]
        )
        if not (before.keypoints[0, 0] > before.keypoints[6, 0]):  # not mirrored
            np.testing.assert_allclose(after.keypoints[:4], before.keypoints[:4], atol=1.5)
    ratios = np.array(ratios)
    assert ratios.min() < 0.75
    assert 1.0 < ratios.max() < 1.3
    assert np.corrcoef(ratios.T)[0, 1] > 0.9
