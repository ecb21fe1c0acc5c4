"""Raised cabins: what is above the lamps moves up with the image, and nothing else does."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fgrecon.io.catalogue import load_category, load_prior
from fgrecon_research.training.keypoints.augment import Street
from fgrecon_research.training.keypoints.deform import UNKNOWN_KIND, LabelledView, belt_of, raise_cabin
from research.tests.training.keypoints.test_augment import MIRROR, PLAIN, in_its_street, made_up_view

BELT = (4, 5, 6, 7)


def dots(points, size=(160, 100)):
    """A black photograph with a bright dot at each keypoint, seen from the side."""
    width, height = size
    row, column = np.mgrid[:height, :width]
    image = sum(255 * np.exp(-((column - u) ** 2 + (row - v) ** 2) / 8.0) for u, v in points)
    image = np.repeat(np.clip(image, 0, 255).astype(np.uint8)[..., None], 3, axis=2)
    return LabelledView(image, np.full((height, width), 255, np.uint8), points, np.ones(len(points)), 1.0)


def car(slope=0.1):
    """Fourteen points: lamps on a line of that slope, wheels below it, mirrors and roof above."""
    across = np.array([30, 50, 110, 130, 15, 40, 120, 145, 55, 65, 70, 85, 100, 115.0])
    belt = 50 + slope * (across - across[list(BELT)].mean())
    return np.column_stack([across, belt + np.array([30, 30, 30, 30, 0, 0, 0, 0, -15, -15, -30, -30, -30, -30.0])])


@settings(max_examples=30, deadline=None)
@given(slope=st.floats(-0.3, 0.3), factor=st.floats(1.05, 2.2), street=st.booleans())
def test_the_cabin_is_that_much_higher_and_the_image_goes_along(slope, factor, street):
    view = dots(car(slope))
    view = in_its_street(view) if street else view
    raised = raise_cabin(view, BELT, factor)
    new = raised.image.shape[0] - view.image.shape[0]
    assert new >= 0
    np.testing.assert_allclose(raised.keypoints[:8], view.keypoints[:8] + np.array([0, new]), atol=1e-6)
    up = (view.keypoints - raised.keypoints)[8:, 1] + new
    np.testing.assert_allclose(up, (factor - 1.0) * np.array([15, 15, 30, 30, 30, 30]), atol=1e-6)
    np.testing.assert_allclose(raised.keypoints[:, 0], view.keypoints[:, 0])
    for (u, v), (x, y) in zip(view.keypoints, raised.keypoints, strict=True):
        if 0 <= y < raised.image.shape[0] - 1:  # the dot is where the keypoint went
            assert raised.image[round(y), round(x)].max() > 0.6 * view.image[round(v), round(u)].max()
    np.testing.assert_allclose(raised.box - view.box, [0, 0, 0, new])


def test_the_part_below_the_lamps_and_the_mask_stay_as_they_were():
    view = dots(car(0.0))
    view.mask[:10] = 0
    raised = raise_cabin(view, BELT, 1.5)
    new = raised.image.shape[0] - view.image.shape[0]
    np.testing.assert_array_equal(raised.image[50 + new :], view.image[50:])
    assert (raised.mask[50 + new :] == 255).all()
    assert (raised.mask[: 45 - round(1.5 * 40) + new] == 0).all()


@pytest.mark.parametrize(
    ("belt", "factor", "slope", "unknown"),
    [((), 1.5, 0.0, ()), (BELT, 1.0, 0.0, ()), (BELT, 1.5, 0.8, ()), (BELT, 1.5, 0.0, (4, 5, 6))],
)
def test_a_car_whose_belt_is_not_known_stays_as_it_is(belt, factor, slope, unknown):
    points = car(slope)
    points[list(unknown)] = np.nan
    view = replace(dots(car(slope)), keypoints=points)
    assert raise_cabin(view, belt, factor) is view


def test_unknown_keypoints_stay_unknown():
    points = car()
    points[[4, 12]] = np.nan
    raised = raise_cabin(replace(dots(car()), keypoints=points), BELT, 1.7)
    assert np.isnan(raised.keypoints[[4, 12]]).any(axis=1).all()
    assert np.isfinite(np.delete(raised.keypoints, [4, 12], axis=0)).all()


def test_the_belt_of_a_car_are_its_lamps():
    prior = load_prior("car14")
    assert Street().shaping(prior).belt == belt_of(prior.category, prior.mean)
    assert {prior.category.keypoints[k] for k in belt_of(prior.category, prior.mean)} == {
        f"{side}_{lamp}" for side in ("left", "right") for lamp in ("headlight", "taillight")
    }
    assert belt_of(replace(load_category("car14"), faces=()), prior.mean) == ()


@pytest.mark.parametrize(("factor", "kind"), [(1.1, 0), (1.6, UNKNOWN_KIND)])
def test_a_much_higher_car_is_of_no_kind_that_anybody_could_name(factor, kind):
    view = replace(made_up_view(np.random.default_rng(0)), kind=0)
    assert raise_cabin(view, BELT, factor).kind == kind
    assert view.mirrored(MIRROR).kind == 0


def test_raised_samples_are_drawn_as_often_as_is_said():
    view = made_up_view(np.random.default_rng(0))
    before, after = (replace(PLAIN, stretch=0.0, bend=0.0, moved=0.0, belt=BELT, raised=share) for share in (0.0, 0.3))
    changed = 0
    for seed in range(60):
        one, other = (s.sample(view, lambda _: view, MIRROR, np.random.default_rng(seed)) for s in (before, after))
        changed += one.keypoints.shape != other.keypoints.shape or not np.allclose(one.keypoints, other.keypoints)
    assert 8 <= changed <= 30
