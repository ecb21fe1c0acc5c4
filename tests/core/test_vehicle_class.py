"""Classes of vehicles by the names of other programs, and the sizes that go with them."""

import numpy as np
import pytest

import fgrecon
from fgrecon.core.choices import ClassScheme
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.size_prior import SIZE_PRIORS
from fgrecon.io.catalogue import shipped_class_sizes

SIZES = shipped_class_sizes()


def test_a_name_is_a_class_that_is_sure():
    one = fgrecon.VehicleClass("Van", "kitti")
    assert (one.probabilities, one.scheme) == ({"Van": 1.0}, ClassScheme.KITTI)
    assert "Van 1.00" in repr(one)


@pytest.mark.parametrize(
    ("wrong", "match"),
    [({}, "vehicle_class"), ({"car": -0.1}, "sum to at most one"), ({"car": 0.7, "van": 0.5}, "sum to"), (3, "name")],
)
def test_what_is_no_probability_is_refused(wrong, match):
    with pytest.raises(InvalidInputError, match=match):
        fgrecon.VehicleClass(wrong)


def test_an_unknown_scheme_or_name_is_refused():
    with pytest.raises(InvalidInputError, match="Use one of fgrecon, kitti"):
        fgrecon.VehicleClass("car", "imagenet")
    with pytest.raises(InvalidInputError, match="Names of kitti are car, van, truck, tram"):
        SIZES.probabilities({"Pedestrian": 1.0}, "kitti")


@pytest.mark.parametrize(
    ("name", "scheme", "expected"),
    [
        ("Truck", "kitti", "lorry"),
        ("vehicle.bus.bendy", "nuscenes", "bus"),
        ("VehicleVan", "openlabel", "van"),
        ("van", "fgrecon", "van"),
        ("car", "yolo", "car"),
        ("train", "coco", "tram"),
    ],
)
def test_names_of_other_programs(name, scheme, expected):
    found = SIZES.probabilities({name: 1.0}, scheme)
    assert max(found, key=found.get) == expected
    assert sum(found.values()) == pytest.approx(1.0, abs=1e-3)


def test_every_scheme_is_there_and_has_whole_probabilities():
    assert {*SIZES.schemes} == {scheme.value for scheme in ClassScheme}
    for names in SIZES.schemes.values():
        for classes in names.values():
            assert {*classes} <= {*SIZES.mean}
            assert sum(classes.values()) == pytest.approx(1.0, abs=1e-3)


def test_what_is_missing_to_one_is_as_common_as_among_all():
    found = SIZES.probabilities({"car": 0.5}, "fgrecon")
    assert found["van"] == pytest.approx(0.5 * SIZES.share["van"])
    assert found["car"] == pytest.approx(0.5 + 0.5 * SIZES.share["car"])


def test_a_sure_class_has_its_size():
    van = SIZES.size({"van": 1.0}, None, any_fleet=False)
    assert van.name == "van"
    np.testing.assert_allclose(van.mean, SIZES.mean["van"])
    np.testing.assert_allclose(van.spread, SIZES.covariance["van"])
    assert van.coarse is None


def test_a_class_that_is_not_sure_is_a_mix_of_sizes():
    draws = np.random.default_rng(0)
    both = np.concatenate(
        [
            draws.multivariate_normal(SIZES.mean[one], SIZES.covariance[one], n)
            for one, n in (("car", 140_000), ("van", 60_000))
        ]
    )
    mixed = SIZES.size({"car": 0.7, "van": 0.3}, None, any_fleet=False)
    np.testing.assert_allclose(mixed.mean, both.mean(axis=0), atol=0.01)
    np.testing.assert_allclose(mixed.spread, np.cov(both.T), atol=0.01)


def test_a_size_is_that_of_cars_and_vans_or_of_what_is_larger_and_no_mean_of_these():
    small = SIZES.size({"car": 0.2, "van": 0.4, "lorry": 0.4}, None, any_fleet=False)
    large = SIZES.size({"car": 0.2, "lorry": 0.5, "bus": 0.3}, None, any_fleet=False)
    assert (small.classes, small.coarse) == (("car", "van"), None)
    assert (large.classes, large.coarse) == (("lorry", "bus"), "cuboid14")
    assert small.mean[0] < 5.5 < 9.0 < large.mean[0]


def test_of_any_fleet_sizes_spread_more():
    own, other = (SIZES.size({"van": 1.0}, None, any_fleet=any_fleet) for any_fleet in (False, True))
    assert (np.linalg.eigvalsh(other.spread - own.spread) > 0.0).all()


def test_cars_of_a_given_fleet_have_its_size():
    given = SIZES.size({"car": 1.0}, SIZE_PRIORS["apollo79"], any_fleet=True)
    np.testing.assert_allclose(given.mean, SIZE_PRIORS["apollo79"].mean)
