"""Points on a vehicle's surface: rows against numeric derivatives, the compiled rows against numpy, a solve."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.utils.numerical_derivative import numericalDerivative11

from factors import D, L, X
from factors.mixture import Form
from factors.native import native
from factors.placed_points import PlacedPointsFactor
from factors.surface_patches import SurfacePatches
from factors.surface_points import PointOdds, PointRows, Shared, SurfacePointsFactor

ODDS = PointOdds(
    vehicle=0.5,
    span=4.0,
    before=0.3,
    through=0.05,
    deepest=0.5,
    core=0.85,
    reach=0.1,
    reach_sigma=0.12,
    beyond=0.1,
    edge=0.5,
)
FACES = np.array(
    [
        [0, 1, 3],
        [0, 3, 2],
        [4, 6, 7],
        [4, 7, 5],
        [0, 4, 5],
        [0, 5, 1],
        [2, 3, 7],
        [2, 7, 6],
        [0, 2, 6],
        [0, 6, 4],
        [1, 5, 7],
        [1, 7, 3],
    ]
)
HALF, UP = np.array([2.0, 0.75, 0.9]), np.array([0.0, -0.75, 0.0])


def cuboid() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices of a cuboid of 4 x 1.8 x 1.5 m, cut finely, a coefficient that makes it longer and one, higher."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    vertices, faces = signs * HALF + UP, FACES
    for _ in range(3):
        corners = vertices[faces]
        middles = (corners + np.roll(corners, -1, axis=1)) / 2.0
        base = len(vertices)
        vertices = np.concatenate([vertices, middles.reshape(-1, 3)])
        a, b, c = (base + 3 * np.arange(len(faces)) + i for i in range(3))
        first, second, third = faces.T
        pieces = ([first, a, c], [a, second, b], [c, b, third], [a, b, c])
        faces = np.concatenate([np.stack(piece, axis=1) for piece in pieces])
    basis = np.zeros((2, *vertices.shape))
    basis[0, :, 0], basis[1, :, 1] = 0.1 * vertices[:, 0], 0.1 * vertices[:, 1]
    return vertices, basis, faces


def measured(rng: np.random.Generator, pose: gtsam.Pose3, count: int = 80) -> np.ndarray:
    """Points on the sides that the camera sees, and some of the ground and a wall."""
    local = rng.uniform(-1.0, 1.0, (count, 3)) * HALF + UP
    sensor = -pose.rotation().matrix().T @ pose.translation()
    local[: count // 2, 0] = np.sign(sensor[0]) * HALF[0]
    local[count // 2 :, 2] = np.sign(sensor[2]) * HALF[2]
    others = np.concatenate(
        [rng.uniform([-3, 0, -3], [3, 0, 3], (20, 3)), rng.uniform([4, -2, -3], [4, 0, 3], (10, 3))]
    )
    local = np.concatenate([local, others])
    return local @ pose.rotation().matrix().T + pose.translation()


POSE = gtsam.Pose3(gtsam.Rot3.Ry(-1.2), np.array([1.0, 1.6, 12.0]))


@pytest.fixture(name="rows")
def _rows() -> PointRows:
    points = measured(np.random.default_rng(1), POSE)
    size, basis = np.array([4.0, 1.8, 1.5]), np.array([[0.4, 0.0], [0.0, 0.0], [0.0, 0.15]])
    patches = SurfacePatches.of(*cuboid())
    sigma, none = np.full(len(points), 0.05), np.zeros(len(points))
    return PointRows(points, sigma, np.zeros(3), patches, size, basis, ODDS, 0.5, none)


@pytest.fixture(name="kind", params=[*Shared])
def _kind(request: pytest.FixtureRequest, rows: PointRows) -> PointRows:
    """Points that share nothing, and those of depth maps, unsure along their rays."""
    if request.param is Shared.NONE:
        return rows
    along = np.random.default_rng(4).uniform(0.05, 0.8, len(rows.points))
    return replace(rows, along=along, shared=request.param)


SHARED = np.array([0.02, 0.03])


def bound(rows: PointRows, share: float = 1.0) -> SurfacePointsFactor:
    """The factor of all variables that the points have."""
    return SurfacePointsFactor(rows, X(0, 0), L(0), D(0), share)


def at(rows: PointRows, change: np.ndarray, coefficients: np.ndarray) -> gtsam.Values:
    """Values near the true pose."""
    values = gtsam.Values()
    values.insert(X(0, 0), POSE.retract(change))
    values.insert(L(0), coefficients)
    if rows.shared is not Shared.NONE:
        values.insert(D(0), SHARED * (1.0 if rows.shared is Shared.DEPTH else 0.1))
    return values


CHANGE = np.array([0.01, 0.03, -0.02, 0.05, 0.02, -0.04])


@pytest.mark.parametrize("form", [Form.WEIGHTED, Form.MAJORISED])
def test_the_jacobian_is_the_numeric_one(kind: PointRows, form: Form) -> None:
    factor = bound(kind)
    values = at(kind, CHANGE, np.array([0.3, -0.5]))
    factor.look(values)
    factor.tell(Form.WEIGHTED)
    _, jacobian = factor(values, want_jacobian=True)

    def residual(key: int, value: object) -> np.ndarray:
        return factor(_with(values, key, value), want_jacobian=False)[0]

    by_pose = numericalDerivative11(lambda pose: residual(X(0, 0), pose), values.atPose3(X(0, 0)))
    by_shape = numericalDerivative11(lambda x: residual(L(0), x), values.atVector(L(0)))
    numeric = [by_pose, by_shape]
    if values.exists(D(0)):
        numeric.append(numericalDerivative11(lambda x: residual(D(0), x), values.atVector(D(0))))
    assert jacobian == pytest.approx(np.hstack(numeric), rel=1e-5, abs=2e-5)
    factor.tell(form)
    rows_at, by = factor(values, want_jacobian=True)
    assert by is not None
    gradient = by.T @ rows_at
    steps = np.eye(len(gradient)) * 1e-6
    slope = [
        (factor.error(_moved(values, step)) - factor.error(_moved(values, -step))) / 2e-6
        for step in steps
    ]  # fmt: skip
    if form is Form.MAJORISED:
        assert gradient == pytest.approx(np.array(slope), rel=1e-4, abs=1e-3)


@pytest.mark.parametrize("form", [Form.WEIGHTED, Form.MAJORISED])
def test_points_of_a_sensor_whose_place_is_unsure_are_those_of_one_that_is_moved(rows: PointRows, form: Form) -> None:
    error = np.array([0.01, -0.02, 0.015, 0.04, -0.03, 0.05])
    factor = PlacedPointsFactor(rows, X(0, 0), L(0), D(0))
    values = at(rows, CHANGE, np.array([0.3, -0.5]))
    values.insert(D(0), error)
    factor.look(values)
    factor.tell(Form.WEIGHTED)
    found, jacobian = factor(values, want_jacobian=True)

    def residual(key: int, value: object) -> np.ndarray:
        return factor(_with(values, key, value), want_jacobian=False)[0]

    numeric = [numericalDerivative11(lambda pose: residual(X(0, 0), pose), values.atPose3(X(0, 0)))]
    numeric += [
        numericalDerivative11(lambda x, key=key: residual(key, x), values.atVector(key)) for key in (L(0), D(0))
    ]
    assert jacobian == pytest.approx(np.hstack(numeric), rel=1e-5, abs=2e-5)
    moved = gtsam.Pose3.Expmap(error).matrix()
    points = rows.points @ moved[:3, :3].T + moved[:3, 3]
    there = bound(replace(rows, points=points, origin=moved[:3, 3]))
    there.look(values)
    there.tell(form)
    factor.tell(form)
    found, by = factor(values, want_jacobian=True)
    expected, wanted = there(values, want_jacobian=True)
    assert found == pytest.approx(expected, abs=1e-6)
    assert by is not None
    assert by[:, :8] == pytest.approx(wanted, abs=1e-6)
    assert factor.points == pytest.approx(points)
    assert factor.energy(values) == pytest.approx(there.energy(values))


def _with(values: gtsam.Values, key: int, value: object) -> gtsam.Values:
    other = gtsam.Values(values)
    other.update(key, value)
    return other


def _moved(values: gtsam.Values, step: np.ndarray) -> gtsam.Values:
    other = gtsam.Values(values)
    other.update(X(0, 0), values.atPose3(X(0, 0)).retract(step[:6]))
    other.update(L(0), values.atVector(L(0)) + step[6:8])
    if values.exists(D(0)):
        other.update(D(0), values.atVector(D(0)) + step[8:])
    return other


@pytest.mark.skipif(native("factors._points") is None, reason="no compiled kernel")
def test_the_compiled_rows_are_those_of_numpy(kind: PointRows) -> None:
    rows, plain = kind, replace(kind)
    plain.__dict__["compiled"] = None
    rng = np.random.default_rng(2)
    for _ in range(5):
        pose = POSE.retract(rng.normal(0.0, 0.2, 6))
        state = pose.rotation().matrix(), pose.translation(), rng.normal(0.0, 1.0, 2), SHARED
        match, other = rows.match(*state), plain.match(*state)
        assert (match.patch == other.patch).all()
        assert match.right == pytest.approx(other.right, abs=1e-12)
        assert match.wrong == pytest.approx(other.wrong, abs=1e-12)
        assert match.sigma == pytest.approx(other.sigma, abs=1e-12)
        (off, by), (other_off, other_by) = (one.distances(match, *state, want=True) for one in (rows, plain))
        assert off == pytest.approx(other_off, abs=1e-9)
        assert by == pytest.approx(other_by, rel=1e-9, abs=1e-9)
        (weights, energy), (other_weights, other_energy) = rows.assess(match, off), plain.assess(other, other_off)
        assert weights == pytest.approx(other_weights, abs=1e-9)
        assert energy == pytest.approx(other_energy, rel=1e-9)


def test_points_bring_a_vehicle_to_its_place_and_size(rows: PointRows) -> None:
    longer = measured(np.random.default_rng(3), POSE)
    factor = SurfacePointsFactor(replace(rows, points=longer), X(0, 0), L(0))
    values = at(rows, np.array([0.0, 0.05, 0.0, 0.1, 0.05, -0.1]), np.zeros(2))
    for _ in range(15):
        factor.look(values)
        graph = gtsam.NonlinearFactorGraph()
        factor.tell(Form.MAJORISED)
        graph.add(factor.factor())
        graph.add(gtsam.PriorFactorVector(L(0), np.zeros(2), gtsam.noiseModel.Isotropic.Sigma(2, 1.0)))
        graph.add(gtsam.PriorFactorPose3(X(0, 0), values.atPose3(X(0, 0)), gtsam.noiseModel.Isotropic.Sigma(6, 0.2)))
        values = values.retract(graph.linearize(values).optimize())
    off = POSE.localCoordinates(values.atPose3(X(0, 0)))
    assert np.abs(off[:3]).max() < 0.02
    assert np.abs(off[3:]).max() < 0.12  # half of a length that is not known
    assert factor.weights[:80].mean() > 0.8
    assert factor.weights[80:].mean() < 0.1


def test_points_far_inside_or_behind_cost_more_than_those_beside(rows: PointRows) -> None:
    beside, behind = np.array([[4.0, 0.0, 12.0]]), np.array([[1.3, 1.0, 20.0]])
    energies = []
    for points in (beside, behind):
        one = replace(rows, points=points, sigma=np.array([0.05]), along=np.zeros(1))
        state = POSE.rotation().matrix(), POSE.translation(), np.zeros(2)
        match = one.match(*state)
        energies.append(one.assess(match, one.distances(match, *state, want=False)[0])[1])
    assert energies[1] - energies[0] == pytest.approx(0.5 * np.log(1.0 / ODDS.through), rel=1e-3)


@pytest.mark.parametrize("numpy", [False, True])
def test_points_where_a_side_goes_on_beyond_its_edges_cost_more_than_others(rows: PointRows, numpy: bool) -> None:
    sensor = np.sign(-POSE.rotation().matrix().T @ POSE.translation())
    on = np.array([-2.3, -0.8, 0.9]), np.array([2.0, -1.8, 0.3])  # past the far end of a side; above the near end
    off = np.array([-2.3, -0.8, 1.4]), np.array([-2.6, -0.8, 0.9]), np.array([-2.3, -0.1, 0.9])  # aside, far, low
    state = POSE.rotation().matrix(), POSE.translation(), np.zeros(2)
    wrong = []
    for local in (*on, *off):
        place = POSE.transformFrom(local * [sensor[0], 1.0, sensor[2]])
        one = replace(rows, points=place[None], sigma=np.array([0.05]), along=np.zeros(1))
        if numpy:
            one.__dict__["compiled"] = None
        wrong.append(one.match(*state).wrong[0])
    assert wrong == pytest.approx([ODDS.beyond * wrong[2]] * 2 + [wrong[2]] * 3)


def test_constants_are_no_variables(rows: PointRows) -> None:
    values = at(rows, CHANGE, np.zeros(2))
    whole = SurfacePointsFactor(rows, X(0, 0), L(0))
    held = SurfacePointsFactor(rows, X(0, 0), np.zeros(2))
    assert held.keys == (X(0, 0),)
    expected = whole(values, want_jacobian=True)[1]
    assert expected is not None
    assert held(values, want_jacobian=True)[1] == pytest.approx(expected[:, :6])


@pytest.mark.skipif(native("factors._points") is None, reason="no compiled kernel")
@pytest.mark.parametrize("form", [*Form])
@pytest.mark.parametrize("looked", [True, False])
def test_the_compiled_rows_of_a_graph_are_those_of_the_callback(kind: PointRows, form: Form, looked: bool) -> None:
    rows, callback = kind, bound(kind, 0.5)
    values = at(rows, CHANGE, np.array([0.3, -0.5]))
    callback.tell(form, 4.0)
    factor = callback.factor()
    if looked:
        callback.look(values)
    pose, coefficients = values.atPose3(X(0, 0)).matrix(), values.atVector(L(0))
    state = [np.concatenate([pose[:3, :3].ravel(), pose[:3, 3]]), coefficients]
    if rows.shared is not Shared.NONE:
        state.append(values.atVector(D(0)))
    residual, jacobian = np.empty(len(rows.points)), np.zeros((len(rows.points), factor.compiled.source.columns))
    factor.compiled.source.evaluate(state, residual, jacobian)
    expected, by = callback(values, want_jacobian=True)
    assert residual == pytest.approx(expected, abs=1e-9)
    if form is not Form.LOSS:  # which has no derivatives
        assert jacobian == pytest.approx(by, rel=1e-8, abs=1e-8)


def test_a_point_that_is_unsure_along_its_ray_is_on_the_patch_that_the_ray_meets(rows: PointRows) -> None:
    """Pixels on the rear, put metres nearer or farther along their rays, stay the rear's and are no worse for it."""
    rear = np.array([[-2.0, y, z] for y in np.linspace(-1.2, -0.3, 7) for z in np.linspace(-0.6, 0.6, 7)])
    pose = gtsam.Pose3(gtsam.Rot3.Ry(-1.5), np.array([0.5, 1.6, 12.0]))
    true = rear @ pose.rotation().matrix().T + pose.translation()
    state, ones = (pose.rotation().matrix(), pose.translation(), np.zeros(2)), np.ones(len(rear))
    for moved in (-1.5, 0.0, 1.5):
        points = true * (1.0 + moved / np.linalg.norm(true, axis=1))[:, None]
        pixels = replace(rows, points=points, sigma=0.05 * ones, along=ones)
        match = pixels.match(*state)
        assert (pixels.patches.normal[match.patch][:, 0] < -0.99).all()
        assert match.right.min() > 0.3
        off = pixels.distances(match, *state, want=False)[0]
        assert off == pytest.approx(-moved * ones, abs=0.05)  # the rear's normal points to the camera


def test_what_pixels_share_moves_them_along_their_rays(kind: PointRows) -> None:
    placed = kind.placed(SHARED)
    if kind.shared is Shared.NONE:
        assert placed is kind.points
        return
    before, after = kind.points[:, 2], placed[:, 2]
    if kind.shared is Shared.DEPTH:
        assert after == pytest.approx(np.exp(0.02) * before + 0.03)
    else:
        assert 1.0 / after == pytest.approx(np.exp(0.02) / before + 0.03)
    assert placed / after[:, None] == pytest.approx(kind.points / before[:, None])


@pytest.mark.skipif(native("factors._points") is None, reason="no compiled kernel")
def test_the_compiled_rows_judge_as_the_callback_looks(kind: PointRows) -> None:
    """Also where points keep their patches: on request, and near where they were matched."""
    plain = replace(kind)
    plain.__dict__["compiled"] = None
    judging, looking = bound(kind), bound(plain)
    assert judging.judges
    assert not looking.judges
    for step, hold in ((0.0, False), (1e-4, False), (0.02, True), (0.02, False), (0.021, False), (0.1, False)):
        values = at(kind, CHANGE + step, np.array([0.3, -0.5]) + step)
        for one in (judging, looking):
            one.look(values, hold=hold)
        assert judging.weights == pytest.approx(looking.weights, abs=1e-9)
        assert judging.points == pytest.approx(looking.points, abs=1e-12)
        for one, other in zip(judging(values, want_jacobian=True), looking(values, want_jacobian=True), strict=True):
            assert one == pytest.approx(other, rel=1e-8, abs=1e-8)
