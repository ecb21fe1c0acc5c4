"""Views of several sources, and how often each is drawn."""

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.catalogue import load_category
from fgrecon_research.training.keypoints.augment import Street
from fgrecon_research.training.keypoints.street_cars import StreetCars, StreetShare, learning
from fgrecon_research.training.keypoints.views import Together, TrainingSet, Views
from research.tests.training.keypoints.test_augment import in_its_street, made_up_view

MIRROR = load_category("car14").mirror


class Same(Views):
    """Views that differ in their direction alone, and know how often they were asked for."""

    def __init__(self, azimuth):
        self.azimuth, self.asked = np.asarray(azimuth, dtype=float), []
        self.made = made_up_view(np.random.default_rng(0))

    def view(self, index):
        self.asked.append(index)
        return self.made


def street_cars(drives, tracks, kinds, azimuth):
    view = in_its_street(made_up_view(np.random.default_rng(1), (90, 60)))
    count = len(drives)
    return StreetCars(
        np.stack([view.image] * count),
        np.stack([view.mask] * count),
        np.stack([view.box] * count),
        np.stack([view.keypoints] * count),
        np.ones((count, 14)),
        np.asarray(azimuth, dtype=float),
        np.array(drives),
        np.array(tracks),
        np.array(kinds),
    )


def test_sources_are_numbered_through():
    first, second = Same([0.0, 0.1]), Same([0.2, 0.3, 0.4])
    both = Together([first, second])
    np.testing.assert_array_equal(both.azimuth, [0.0, 0.1, 0.2, 0.3, 0.4])
    for index in range(5):
        both.view(index)
    assert (first.asked, second.asked) == ([0, 1], [0, 1, 2])


def test_samples_come_by_weight_and_by_seed_alone():
    views = Same([0.0, 0.5, 1.0])
    drawn = TrainingSet(views, np.array([0, 2]), np.array([1.0, 0.0]))
    street = Street(size=32, cut_out=0.0, covered=0.0)
    one, again = (drawn.draw(street, MIRROR, (4, 7)) for _ in range(2))
    np.testing.assert_array_equal(one.crop, again.crop)
    assert set(views.asked) == {0}
    other = drawn.draw(street, MIRROR, (4, 8))
    assert (other.crop != one.crop).any()


def test_street_cars_have_their_share_and_left_out_drives_none():
    photographs = Same(np.linspace(-3.0, 3.0, 40))
    cars = street_cars(["a", "a", "b", "b", "b"], [1, 1, 1, 2, 2], ["Car"] * 5, [3.0, 3.1, 0.1, -3.0, 2.9])
    given = StreetShare(cars, 0.3, ("b",))
    found = learning(photographs, np.arange(0, 40, 2), given)
    assert found.chosen[-2:].tolist() == [40, 41]
    assert len(found.chosen) == 22
    assert found.weights[:20].sum() == pytest.approx(0.7)
    assert found.weights[20:].sum() == pytest.approx(0.3)
    assert given.describe() == "2 street cars in 0.3 of the samples, without b"
    with pytest.raises(InvalidInputError, match="without"):
        learning(photographs, np.arange(40), StreetShare(cars, 0.3, ("a", "b")))
    alone = learning(photographs, np.arange(40), None)
    assert alone.views is photographs
    assert alone.weights.sum() == pytest.approx(1.0)


def test_long_tracks_do_not_outweigh_short_ones_and_vans_count_more():
    """All from one direction, so that directions do not matter: a track of nine counts as three of one."""
    cars = street_cars(["a"] * 11, [1] * 9 + [2, 3], ["Car"] * 10 + ["Van"], [0.0] * 11)
    weights = cars.weights(np.arange(11))
    assert weights[:9].sum() == pytest.approx(3.0 * weights[9])
    assert weights[10] == pytest.approx(1.5 * weights[9])
