"""Any number of classes: as one mixture, by their probabilities, and from a file of sizes."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import fgrecon
from fgrecon import VehicleClass
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.catalogue import coarse_prior, load_prior, load_size_prior, shipped_class_sizes
from fgrecon.io.kitti_files import read_images
from fgrecon.solve.either_class import EitherClass, mean_weights
from fgrecon.solve.fitted_class import (
    odds_before_image,
    open_classes,
    probabilities,
    with_energies,
    with_fitted_classes,
)
from fgrecon.solve.inputs import SolveSetup, as_ground
from tests.cars import CAMERA, observe, yaw_pose

MINIBUS = np.array([6.5, 2.1, 2.9])
PLACE = np.array([2.0, 1.65, 22.0])
SIZES = shipped_class_sizes()
SEEDS = st.integers(0, 2**32 - 1)


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    """A file of cars, vans, minibuses and lorries, of which the package knows no minibuses."""
    minibus = {"share": 0.05, "mean": MINIBUS.tolist(), "covariance": np.diag((0.05 * MINIBUS) ** 2).tolist()}
    classes = {name: {"share": SIZES.share[name]} for name in ("car", "van", "lorry")}
    path = tmp_path_factory.mktemp("sizes") / "street.json"
    path.write_text(json.dumps({"name": "street", "classes": {**classes, "minibus": minibus}}))
    return path


def seen(size, place=PLACE, prior=None):
    prior = load_prior("car14") if prior is None else prior
    return observe(
        prior.for_fleet(fgrecon.SizePrior("seen", size, 0.03 * size)), yaw_pose(2.0, place), noise=0.3, seed=3
    )


def drawn(seed, count):
    """Names, log weights and energies of classes."""
    draws = np.random.default_rng(seed)
    names = [*SIZES.mean][:count]
    weights = dict(zip(names, draws.normal(0.0, 2.0, count).tolist(), strict=True))
    return draws, names, weights, dict(zip(names, draws.uniform(0.0, 40.0, count).tolist(), strict=True))


@given(seed=SEEDS, count=st.integers(2, 5), total=st.floats(0.1, 1.0))
def test_the_order_of_classes_does_not_matter(seed, count, total):
    draws, names, weights, energies = drawn(seed, count)
    order = draws.permutation(names).tolist()
    found = probabilities(with_energies(weights, energies), total)
    other = probabilities(with_energies({n: weights[n] for n in order}, {n: energies[n] for n in order}), total)
    assert sum(found.values()) == pytest.approx(total)
    assert {**other} == pytest.approx(found, abs=1e-12)
    shares = {name: np.exp(weights[name] - 0.6 * min(energies[name] - min(energies.values()), 15.0)) for name in names}
    assert found == pytest.approx({n: total * one / sum(shares.values()) for n, one in shares.items()}, abs=1e-12)


@given(seed=SEEDS, count=st.integers(2, 5))
def test_weights_of_frames_are_beside_one_class(seed, count):
    """Frames need not begin with the same class: as where one of them has no pose as the usual one."""
    draws, names, drawn_weights, _ = drawn(seed, count)
    nothing = (np.zeros((count - 1, 3)), np.zeros(3), *[np.zeros((count - 1, 3))] * 5)
    frames = []
    for order in (names, draws.permutation(names).tolist()):
        beside = {name: drawn_weights[name] - drawn_weights[order[0]] for name in order}
        frames.append(EitherClass(beside, *nothing, np.zeros((count, count - 1))))
    one, both = mean_weights(frames[:1]), mean_weights([frames[0], None, frames[1]])
    assert probabilities(both) == pytest.approx(probabilities(one), abs=1e-12)


@given(seed=SEEDS, count=st.integers(1, 5))
def test_sizes_are_those_of_the_mixture(seed, count):
    draws = np.random.default_rng(seed)
    names = [f"class {i}" for i in range(count)]
    mean = {name: draws.uniform(1.0, 12.0, 3) for name in names}
    covariance = {name: (lambda a: a @ a.T + 0.01 * np.eye(3))(draws.normal(0.0, 0.4, (3, 3))) for name in names}
    sizes = replace(SIZES, mean=mean, covariance=covariance, coarse={})
    share = dict(zip(names, draws.dirichlet(np.ones(count)).tolist(), strict=True))
    found = sizes.size(share, None, any_fleet=False)
    p, means = np.array([*share.values()]), np.array([*mean.values()])
    within = np.einsum("c,cij->ij", p, np.array([*covariance.values()]))
    np.testing.assert_allclose(found.mean, p @ means, rtol=1e-9)
    np.testing.assert_allclose(found.own_spread, within, rtol=1e-9, atol=1e-12)
    between = np.cov(means.T, aweights=p, bias=True) if count > 1 else 0.0
    np.testing.assert_allclose(found.spread, within + between, rtol=1e-6, atol=1e-9)
    order = draws.permutation(names).tolist()
    other = replace(sizes, mean={n: mean[n] for n in order}).size({n: share[n] for n in order}, None, any_fleet=False)
    np.testing.assert_allclose(other.spread, found.spread, rtol=1e-9, atol=1e-12)
    with_none = sizes.size({**share, names[0]: share[names[0]], "none": 0.0}, None, any_fleet=False)
    np.testing.assert_array_equal(with_none.spread, found.spread)
    np.testing.assert_array_equal(with_none.mean, found.mean)


@pytest.fixture(scope="module")
def result():
    return fgrecon.reconstruct(seen(np.array([3.9, 1.6, 1.5])), CAMERA, size_prior="apollo79", ground=1.65)


@given(seed=SEEDS, others=st.integers(1, 3), taken_for=st.integers(0, 3))
def test_covariances_have_what_lies_between_all_classes(result, seed, others, taken_for):
    """Those of a vehicle that was solved with the size of one of them, by their log weights."""
    draws = np.random.default_rng(seed)
    weights = {f"{i}": float(w) for i, w in enumerate(draws.normal(0.0, 2.0, others + 1))}
    first, sizes = np.array([4.0, 1.6, 1.5]), np.linalg.qr(draws.normal(size=(3, 3)))[0][:others]
    moves = draws.normal(0.0, 2.0, (others, 3))
    dimension = len(result.uncertainty.coefficients_covariance)
    either = EitherClass(
        weights,
        np.zeros((others, 3)),
        result.location,
        moves,
        draws.normal(size=(others, dimension)),
        draws.normal(size=(others, 14, 3)),
        sizes,
        first,
        np.zeros((others + 1, others)),
    )
    ends = np.vstack([first, first + sizes])
    at = ends[min(taken_for, others)]
    solved = replace(result, shape=replace(result.shape, box_size=at))
    p = np.exp([*weights.values()]) / np.exp([*weights.values()]).sum()
    found = either.added_to(solved, weights).uncertainty
    added = found.size_covariance - solved.uncertainty.size_covariance
    np.testing.assert_allclose(added, np.einsum("c,ci,cj->ij", p, ends - at, ends - at), atol=1e-9)
    off = np.vstack([np.zeros(3), moves]) - np.vstack([np.zeros(3), moves])[min(taken_for, others)]
    place = (found.pose_covariance - solved.uncertainty.pose_covariance)[3:, 3:]
    rotation = result.camera_T_object[:3, :3]
    np.testing.assert_allclose(rotation @ place @ rotation.T, np.einsum("c,ci,cj->ij", p, off, off), atol=1e-9)
    down = np.array([0.0, 1.0, 0.0])
    mean, sigma = either.lower(result.location, at, down, weights)
    assert mean == pytest.approx(p @ off @ down, abs=1e-9)
    assert sigma**2 == pytest.approx(p @ (off @ down - p @ off @ down) ** 2, abs=1e-9)


def test_a_class_without_a_share_is_not_open(street):
    setup = SolveSetup.of("car14", street, None)
    assert open_classes(None, setup) == ["car", "van", "minibus"], "a lorry has another shape"
    said = {"car": 0.4, "van": 0.3, "lorry": 0.3, "bus": 0.0, "tram": 0.0, "minibus": 0.0}
    assert open_classes(said, setup) == ["car", "van"]
    assert open_classes({**said, "car": 0.0, "van": 0.0, "bus": 0.7}, setup) == ["lorry", "bus"]
    assert open_classes({**dict.fromkeys(said, 0.0), "bus": 1.0}, setup) == []


def test_shares_of_the_package_are_its_fleet(tmp_path):
    """A file of cars and vans alone, as often as KITTI has them, is `kitti_traffic`."""
    path = tmp_path / "two.json"
    path.write_text(json.dumps({"name": "two", "classes": {n: {"share": SIZES.share[n]} for n in ("car", "van")}}))
    own, shipped = (SolveSetup.of("car14", fleet, None) for fleet in (str(path), "kitti_traffic"))
    for setup in (own, shipped):
        assert odds_before_image(["car", "van"], None, setup)[0] == pytest.approx({"car": 0.0, "van": -1.0})
    van = seen(np.array([5.0, 1.9, 2.2]))
    found = [fgrecon.reconstruct(van, CAMERA, size_prior=one, ground=1.65) for one in (path, "kitti_traffic")]
    np.testing.assert_allclose(found[0].location, found[1].location, atol=1e-6)


def test_a_third_class_is_where_it_is(street):
    minibus = seen(MINIBUS)
    off = {
        name: np.linalg.norm(fgrecon.reconstruct(minibus, CAMERA, size_prior=fleet, ground=1.65).location - PLACE)
        for name, fleet in {"street": street, "traffic": "kitti_traffic", "kitti": "kitti"}.items()
    }
    assert off["street"] < 0.7 * off["traffic"] < 0.7 * off["kitti"]
    setup = SolveSetup.of("car14", street, None)
    each = [minibus, seen(np.array([3.9, 1.6, 1.5]))]
    fitted, car = (one.evidence[-1].probabilities for one in with_fitted_classes(each, CAMERA, setup, as_ground(1.65)))
    assert fitted["minibus"] > 5.0 * car["minibus"]
    assert car["car"] > 0.5 > fitted["car"]
    tracker = fgrecon.Tracker(size_prior=street, shared_ground=True)
    for time in (0.0, 0.1, 0.2):
        estimate = tracker.update(time, {0: minibus}, camera=CAMERA, ground=1.65)[0]
    assert np.linalg.norm(estimate.reconstruction.location - PLACE) < off["traffic"]
    said = fgrecon.reconstruct(minibus, CAMERA, size_prior=street, evidence=[VehicleClass("minibus")])
    assert said.shape.prior == "car14 of minibus"


def test_a_lorry_or_a_bus_is_as_unsure_as_that(street):
    cuboid, place = coarse_prior("cuboid14", load_prior("car14").category.keypoints), np.array([2.0, 1.65, 25.0])
    one = seen(SIZES.mean["lorry"], place, cuboid)
    sure, either = (
        fgrecon.reconstruct(one, CAMERA, size_prior=street, ground=1.65, evidence=[VehicleClass(said)])
        for said in ({"lorry": 1.0}, {"lorry": 0.6, "bus": 0.4})
    )
    assert sure.shape.category == either.shape.category == "cuboid14"
    assert "the shape of a lorry or bus is a cuboid" in either.reasons
    assert np.trace(either.uncertainty.pose_covariance[3:, 3:]) > np.trace(sure.uncertainty.pose_covariance[3:, 3:])


@pytest.mark.parametrize(
    ("classes", "match"),
    [
        ({"van": {"share": 1.0}}, "that of car positive"),
        ({"car": {"share": 1.0}, "van": {"share": -0.1}}, "none negative"),
        ({"car": {}}, r"car\.share"),
        ({"car": {"share": 0.9}, "pickup": {"share": 0.1}}, r"pickup\.mean"),
        ({"car": {"share": 0.9, "mean": [4.0, 1.8, 1.5], "covariance": [[-1, 0, 0]] * 3}}, r"car\.size_prior\.traffic"),
    ],
)
def test_what_is_no_fleet_is_refused(tmp_path, classes, match):
    path = tmp_path / "wrong.json"
    path.write_text(json.dumps({"name": "wrong", "classes": classes}))
    with pytest.raises(InvalidInputError, match=match):
        load_size_prior(path)
    with pytest.raises(InvalidInputError, match="kitti_traffic"):
        load_size_prior(tmp_path / "none.json")


@pytest.mark.data
def test_lorries_of_a_street_are_where_they_are_labelled(street, data):
    """By the labels' classes; and a car beside them is no worse for a fleet with lorries."""
    drive = read_images(data / "kitti_drives" / "kitti_tracking_0006")
    frame = next(one for one in drive.frames if one.objects.kind.count("Truck") == 1 and "Car" in one.objects.kind)
    o = frame.objects
    rows = [i for i, kind in enumerate(o.kind) if kind in ("Truck", "Car") and o.occlusion[i] == 0 and frame.boxed[i]]
    boxes, camera = o.box[rows], frame.calibration.camera
    given = [VehicleClass(o.kind[i], "kitti") for i in rows]
    how = {"ground": 1.65, "options": fgrecon.Options(box=fgrecon.BoxModel.CUBOID)}
    without, found = (
        fgrecon.reconstruct_image(frame.image, camera, boxes, size_prior=fleet, classes=classes, **how)
        for fleet, classes in (("kitti", None), (street, given))
    )
    for i, before, after in zip(rows, without, found, strict=True):
        off = [np.linalg.norm(one.result.location - o.location[i]) for one in (before, after)]
        assert after.result.shape.category == ("cuboid14" if o.kind[i] == "Truck" else "car14")
        assert off[1] < 0.5 * off[0] if o.kind[i] == "Truck" else off[1] < off[0] + 0.3
