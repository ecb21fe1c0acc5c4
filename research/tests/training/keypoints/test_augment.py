"""Training samples: the labels stay on what they label."""

from dataclasses import replace

import numpy as np
import pytest

from fgrecon.io.catalogue import load_category
from fgrecon_research.training.keypoints.augment import Street
from fgrecon_research.training.keypoints.deform import LabelledView

MIRROR = load_category("car14").mirror
PLAIN = Street(cut_out=0, covered=0, block=0, truncated=0, seen_alone=0, extent=(200.0, 220.0))


def made_up_view(rng, size=(120, 80)):
    """A black photograph with a bright dot of its own grey value at every keypoint."""
    width, height = size
    row, column = np.mgrid[:height, :width]
    grid = np.stack(np.meshgrid(np.linspace(15, width - 16, 7), [25.0, height - 26.0]), axis=-1).reshape(-1, 2)
    keypoints = grid[rng.permutation(14)] + rng.uniform(-3, 3, (14, 2))
    image = np.zeros((height, width, 3))
    for u, v in keypoints:
        image += 255 * np.exp(-((column - u) ** 2 + (row - v) ** 2) / 8.0)[..., None]
    mask = np.full((height, width), 255, dtype=np.uint8)
    return LabelledView(np.clip(image, 0, 255).astype(np.uint8), mask, keypoints, np.ones(14), 0.7)


def in_its_street(view, around=20):
    """The same view with some of the street around it."""
    wide = [(around, around), (around, around)]
    return LabelledView(
        np.pad(view.image, [*wide, (0, 0)]),
        np.pad(view.mask, wide),
        view.keypoints + around,
        view.visible,
        view.azimuth,
        view.box + around,
    )


class Bright(Street):
    """Without any loss of quality, so that dots can be found again."""

    def _degrade(self, canvas, rng):
        return canvas


@pytest.mark.parametrize("street_car", [False, True])
def test_keypoints_stay_on_their_dots(street_car):
    view = made_up_view(np.random.default_rng(0))
    view = in_its_street(view) if street_car else view
    street = Bright(**{name: getattr(PLAIN, name) for name in PLAIN.__dataclass_fields__})
    row, column = np.mgrid[:96, :96]
    distances = []
    for seed in range(12):
        sample = street.sample(view, lambda _: view, MIRROR, np.random.default_rng(seed))
        for (u, v), seen in zip(sample.keypoints, sample.visible, strict=True):
            if not seen or not (5 < u < 90 and 5 < v < 90):
                continue
            near = sample.crop[..., 0] * (np.hypot(column - u, row - v) < 4.0)
            weight = near.astype(float).sum()
            found = np.array([(near * column).sum(), (near * row).sum()]) / weight
            distances.append(np.hypot(*(found - (u, v))))
    assert len(distances) > 80
    assert np.median(distances) < 0.5


def test_mirroring_swaps_left_and_right_and_turns_the_azimuth():
    view = made_up_view(np.random.default_rng(1))
    twice = view.mirrored(MIRROR).mirrored(MIRROR)
    once = view.mirrored(MIRROR)
    np.testing.assert_allclose(once.keypoints[0], [119, 0] + view.keypoints[1] * [-1, 1])
    assert once.azimuth == -view.azimuth
    np.testing.assert_allclose(twice.keypoints, view.keypoints)
    np.testing.assert_array_equal(twice.image, view.image)


def test_the_same_seed_gives_the_same_sample():
    view = made_up_view(np.random.default_rng(2))
    street = Street()
    first, again = (street.sample(view, lambda _: view, MIRROR, np.random.default_rng(5)) for _ in range(2))
    other = street.sample(view, lambda _: view, MIRROR, np.random.default_rng(6))
    np.testing.assert_array_equal(first.crop, again.crop)
    assert (first.crop != other.crop).any()
    assert first.crop.shape == (96, 96, 3)


@pytest.mark.parametrize("what", ["covered", "block"])
def test_what_is_covered_is_not_visible(what):
    view = made_up_view(np.random.default_rng(3))
    street = replace(PLAIN, **{what: 1.0})
    seen = [street.sample(view, lambda _: view, MIRROR, np.random.default_rng(s)).visible.mean() for s in range(60)]
    plain = [PLAIN.sample(view, lambda _: view, MIRROR, np.random.default_rng(s)).visible.mean() for s in range(60)]
    assert np.mean(seen) < np.mean(plain) - 0.03


def test_beyond_the_border_nothing_is_visible_and_the_crop_follows_the_box():
    view = made_up_view(np.random.default_rng(4))
    street = replace(PLAIN, truncated=1.0, roll=0.0)
    share = [street.sample(view, lambda _: view, MIRROR, np.random.default_rng(s)).visible.mean() for s in range(20)]
    assert 0.3 < np.mean(share) < 0.95


def test_keypoints_of_unknown_place_stay_unknown():
    view = made_up_view(np.random.default_rng(4))
    unknown = view.keypoints.copy()
    unknown[5] = np.nan
    sample = Street().sample(replace(view, keypoints=unknown), lambda _: view, MIRROR, np.random.default_rng(3))
    lost = np.isnan(sample.keypoints).all(axis=1)
    assert lost.sum() == 1
    assert set(lost.nonzero()[0]) <= {5, int(MIRROR[5])}
    assert sample.visible[lost] == 0.0


def test_a_backlit_car_is_darker_and_what_is_around_it_brighter():
    rng = np.random.default_rng(0)
    image, mask = np.full((80, 120, 3), 100, dtype=np.uint8), np.zeros((80, 120), dtype=np.uint8)
    mask[20:60, 30:90] = 255
    view = LabelledView(image, mask, np.full((14, 2), 40.0), np.ones(14), 0.7)
    plain = {name: getattr(PLAIN, name) for name in PLAIN.__dataclass_fields__}
    still = {"jitter": 0.0, "roll": 0.0, "stretch": 0.0, "bend": 0.0, "moved": 0.0}
    street = Bright(**{**plain, **still, "backlit": 1.0})
    crop = street.sample(view, lambda _: view, MIRROR, rng).crop
    assert 20 <= crop[48, 48].max() < 85
    assert crop[48, 12].min() > 115


def test_a_street_car_fills_the_crop_as_a_photograph_does():
    """What is around it changes neither place nor size in the crop."""
    view = made_up_view(np.random.default_rng(0))
    for seed in range(20):
        alone, _, _ = PLAIN._placement(view, np.random.default_rng(seed))
        wider = in_its_street(view)
        among, _, _ = PLAIN._placement(wider, np.random.default_rng(seed))
        np.testing.assert_allclose(
            wider.keypoints @ among[:, :2].T + among[:, 2], view.keypoints @ alone[:, :2].T + alone[:, 2], atol=1e-9
        )


def test_the_mirror_image_of_a_street_car_has_the_mirrored_box():
    view = in_its_street(made_up_view(np.random.default_rng(0)))
    there = view.mirrored(MIRROR)
    np.testing.assert_allclose(there.box[[0, 2]], view.image.shape[1] - 1 - view.box[[2, 0]])
    np.testing.assert_allclose(there.mirrored(MIRROR).box, view.box)
    inside = (there.keypoints >= there.box[:2]) & (there.keypoints <= there.box[2:])
    assert inside.all()


def test_street_cars_are_left_in_their_street():
    """Whatever their mask is, they are never cut out, as photographs are."""
    view = in_its_street(made_up_view(np.random.default_rng(0)))
    how = replace(PLAIN, cut_out=1.0, backlit=0.0)
    masked = replace(view, mask=np.zeros_like(view.mask))
    for seed in range(5):
        one, other = (how.sample(v, lambda _: view, MIRROR, np.random.default_rng(seed)) for v in (view, masked))
        np.testing.assert_array_equal(one.crop, other.crop)


def test_street_cars_are_often_left_as_the_camera_saw_them():
    view = in_its_street(made_up_view(np.random.default_rng(0)))
    kept = Bright(**{name: getattr(PLAIN, name) for name in PLAIN.__dataclass_fields__})
    for seed in range(5):
        left, degraded = (
            how.sample(view, lambda _: view, MIRROR, np.random.default_rng(seed))
            for how in (replace(PLAIN, as_it_is=1.0, extent=(30.0, 40.0)), replace(kept, as_it_is=0.0, backlit=0.0))
        )
        np.testing.assert_array_equal(left.crop, degraded.crop)


def test_a_dull_picture_has_less_colour_and_its_dark_parts_are_darker():
    rng = np.random.default_rng(5)
    view = made_up_view(rng)
    colours = np.clip(view.image * [1.0, 0.5, 0.2] + [60, 40, 30], 0, 255).astype(np.uint8)
    view = replace(view, image=colours)
    still = {"cut_out": 0.0, "covered": 0.0, "block": 0.0, "truncated": 0.0, "backlit": 0.0, "extent": (200.0, 220.0)}

    def seen(dull):
        street = Street(**still, dull=dull)
        crops = [street.sample(view, lambda _: view, MIRROR, np.random.default_rng(s)).crop for s in range(60)]
        spread = [np.ptp(crop.astype(float), axis=2).mean() for crop in crops]
        return np.mean(spread), np.mean([np.quantile(crop, 0.25) for crop in crops])

    (colour, dark), (pale, darker) = seen(0.0), seen(1.0)
    assert pale < 0.8 * colour
    assert darker < dark


class HalfHidden(Bright):
    """Something bright hides the right half of the crop."""

    def _block(self, canvas, cover, rng):
        canvas, cover = canvas.copy(), cover.copy()
        canvas[:, 48:], cover[:, 48:] = 60, 255
        return canvas, cover


@pytest.mark.parametrize("street_car", [False, True])
def test_a_hidden_car_is_seen_by_the_box_of_what_is_seen(street_car):
    view = made_up_view(np.random.default_rng(0))
    view = in_its_street(view) if street_car else view
    still = {"jitter": 0.0, "roll": 0.0, "stretch": 0.0, "bend": 0.0, "moved": 0.0, "raised": 0.0, "backlit": 0.0}
    plain = {"cut_out": 0.0, "covered": 0.0, "truncated": 0.0, "block": 1.0}
    whole, seen = (
        HalfHidden(**still, **plain, seen_alone=share).sample(view, lambda _: view, MIRROR, np.random.default_rng(4))
        for share in (0.0, 1.0)
    )
    # 120 x 80 pixels: of the left half, 60 x 80, the height is the longer side.
    np.testing.assert_allclose(np.ptp(seen.keypoints, axis=0) / np.ptp(whole.keypoints, axis=0), 1.5, atol=0.05)
    np.testing.assert_array_equal(seen.visible, whole.visible)
    assert 3 < np.count_nonzero(seen.visible) < 11
    columns = np.flatnonzero((seen.crop != 127).any(axis=(0, 2)))
    hidden = np.flatnonzero((seen.crop == 60).all(axis=(0, 2)))
    assert abs((columns[0] + hidden[0]) / 2 - 47.5) < 24  # what is seen is in the middle
    assert hidden[0] == pytest.approx(47.5 + 30 * 96 / 1.2 / 80, abs=2)


def test_a_car_of_which_hardly_anything_is_seen_keeps_its_box():
    class Hidden(Bright):
        def _block(self, canvas, cover, rng):
            return canvas, np.full_like(cover, 255)

    view = made_up_view(np.random.default_rng(0))
    whole, seen = (
        Hidden(block=1.0, seen_alone=share).sample(view, lambda _: view, MIRROR, np.random.default_rng(4))
        for share in (0.0, 1.0)
    )
    np.testing.assert_array_equal(seen.keypoints, whole.keypoints)
    assert not seen.visible.any()
