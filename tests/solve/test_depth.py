"""Depth maps of an image with vehicles: metric, with an error that all pixels share, up to scale, or up to a shift."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fgrecon import (
    Camera,
    DepthCalibration,
    DepthMap,
    DepthScale,
    Ground,
    Observation,
    Options,
    StereoPair,
    Tracker,
    reconstruct,
    reconstruct_scene,
    reconstruct_track,
)
from fgrecon.core.geometry import yaw_rotation
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.errors import ContradictoryInputWarning, InvalidInputError
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.inputs import SolveSetup
from fgrecon.solve.proposals.point_term import point_terms, with_its_points
from fgrecon.solve.vehicle.visibility import clearance, probability

SIZE = (620, 190)
CAMERA = replace(Camera.of(np.array([[350.0, 0.0, 310.0], [0.0, 350.0, 85.0], [0.0, 0.0, 1.0]])), image_size=SIZE)
PRIOR = load_prior("car14")
SHAPES = np.array([1.2, -0.8, 0.3, 0.2, -0.4]) * np.array([[1.0], [-1.0], [0.0]])
PLACES = [np.array([2.5, 1.65, 14.0]), np.array([-3.0, 1.65, 20.0]), np.array([-2.5, 1.65, 9.0])]
YAWS = [-1.2, -1.7, 1.2]
OPTIONS = Options(keep_history=False)
HOW: dict[str, Any] = {"ground": Ground.level(1.65), "options": OPTIONS}


@pytest.fixture(name="street", scope="module")
def _street() -> tuple[list[Observation], np.ndarray]:
    """As `street_of`."""
    return street_of()


def street_of(shapes: np.ndarray = SHAPES, seed: int = 0) -> tuple[list[Observation], np.ndarray]:
    """What a network says of three cars of different sizes, and the depth (H, W) of them, the road and a wall."""
    rng = np.random.default_rng(seed)
    row, column = np.mgrid[: SIZE[1], : SIZE[0]]
    rays = CAMERA.rays(np.stack([column, row], axis=-1).astype(float))
    depth = np.minimum(1.65 / np.maximum(rays[..., 1], 1e-6), 45.0)
    seen = []
    surface = PRIOR.surface
    assert surface is not None
    for place, yaw, shape in zip(PLACES, YAWS, shapes, strict=True):
        rotation = yaw_rotation(yaw)
        vertices = surface.vertices(shape) @ rotation.T + place
        _draw(depth, rays, vertices[surface.faces])
        outline = CAMERA.project(vertices)
        box = np.concatenate([outline.min(axis=0), outline.max(axis=0)])
        pixels = CAMERA.project(PRIOR.keypoints(shape) @ rotation.T + place) + rng.normal(0.0, 1.0, (14, 2))
        sensor = -rotation.T @ place
        shown = probability(clearance(surface.vertices(shape), surface.faces, PRIOR.keypoints(shape), sensor))
        seen.append(Observation.of(pixels, np.where(shown > 0.5, 0.9, 0.1), box))
    return seen, depth + 0.02 * rng.normal(size=depth.shape)


def _draw(depth: np.ndarray, rays: np.ndarray, triangles: np.ndarray) -> None:
    """Put triangles (F, 3, 3) before what is in a depth map (H, W)."""
    for corners in triangles:
        pixels = CAMERA.project(corners)
        low = np.maximum(np.ceil(pixels.min(axis=0)), 0).astype(int)
        high = np.minimum(np.floor(pixels.max(axis=0)), np.array(SIZE) - 1).astype(int)
        if (high < low).any():
            continue
        part = np.s_[low[1] : high[1] + 1, low[0] : high[0] + 1]
        try:
            inside = np.linalg.solve(corners.T, rays[part].reshape(-1, 3).T)
        except np.linalg.LinAlgError:
            continue
        hit = (inside >= -1e-9).all(axis=0).reshape(rays[part].shape[:2])
        far = (1.0 / np.maximum(inside.sum(axis=0), 1e-9)).reshape(hit.shape)
        depth[part] = np.where(hit, np.minimum(depth[part], far), depth[part])


def errors(found: list[Reconstruction]) -> np.ndarray:
    """(V,) how far vehicles are off, metres."""
    return np.array([np.linalg.norm(one.location - place) for one, place in zip(found, PLACES, strict=True)])


def test_a_metric_map_tells_the_depth(street: tuple[list[Observation], np.ndarray]) -> None:
    seen, depth = street
    fleet = HOW | {"size_prior": "kitti"}  # whose cars are smaller than these
    alone = reconstruct_scene(seen, CAMERA, **fleet)
    sensed = reconstruct_scene(seen, CAMERA, evidence=[DepthMap(depth, relative_sigma=0.005)], **fleet)
    assert errors(list(alone.vehicles)).max() > 0.8
    assert errors(list(sensed.vehicles)).max() < 0.25
    for one in sensed.vehicles:
        assert one.diagnostics.evidence["depth"] > 1.5
        assert (one.diagnostics.point_weights >= 0.5).sum() > 40
        assert len(one.diagnostics.depth_scales) == 0  # nothing is shared


@pytest.mark.parametrize(
    ("made", "kind", "inverse"),
    [
        (lambda z: 0.4 * z, DepthScale.SCALE, False),
        (lambda z: 2.5 / z, DepthScale.SCALE, True),
        (lambda z: 0.4 * (z + 2.0), DepthScale.SCALE_AND_SHIFT, False),
        (lambda z: 2.5 / z + 0.1, DepthScale.SCALE_AND_SHIFT, True),
    ],
)
def test_scale_and_shift_are_found(
    street: tuple[list[Observation], np.ndarray], made: Any, kind: DepthScale, inverse: bool
) -> None:
    seen, depth = street
    given = DepthMap(made(depth), relative_sigma=0.01, scale=kind, inverse=inverse)
    found = reconstruct_scene(seen, CAMERA, evidence=[given], **HOW).vehicles
    assert errors(list(found)).max() < 0.6
    scale, shift = found[0].diagnostics.depth_scales[0]
    metres = given.metres(made(np.array([8.0, 20.0])), DepthCalibration(scale, shift))
    assert metres == pytest.approx([8.0, 20.0], rel=0.04)
    covariance = found[0].diagnostics.depth_covariances[0]
    assert 0.0 < np.sqrt(covariance[0, 0]) < 0.1 * scale
    for one in found[1:]:  # the image's, which all vehicles share
        assert one.diagnostics.depth_scales == pytest.approx(found[0].diagnostics.depth_scales)


@pytest.mark.parametrize("times", [0.1, 0.2])
def test_a_map_of_another_unit_is_told(street: tuple[list[Observation], np.ndarray], times: float) -> None:
    seen, depth = street
    given = DepthMap(times * depth)
    with pytest.warns(ContradictoryInputWarning, match=r"depth map puts .*metres"):
        found = reconstruct_scene(seen, CAMERA, evidence=[given], **HOW).vehicles
    for one in found:
        (line,) = one.diagnostics.left_out
        said = re.fullmatch(r"depth: left out, its pixels there are (\S+) times as far as the vehicle\.", line)
        assert said is not None
        assert float(said[1]) == pytest.approx(times, rel=0.35)  # by the picture alone places are as far off
    tracker = Tracker(options=OPTIONS)
    estimate = tracker.update(0.0, {0: seen[0]}, camera=CAMERA, ground=1.65, evidence=[given])[0]
    assert estimate.reconstruction.diagnostics.left_out
    right = reconstruct_scene(seen, CAMERA, evidence=[DepthMap(depth)], **HOW).vehicles
    assert not any(one.diagnostics.left_out for one in right)


@pytest.mark.parametrize("times", [1000.0 / 256.0, 5.0])
def test_a_map_by_which_vehicles_are_giants_is_refused(
    street: tuple[list[Observation], np.ndarray], times: float
) -> None:
    """Such as millimetres read as KITTI's numbers: where nothing holds it, a vehicle would follow the map."""
    seen, depth = street
    given = DepthMap(times * depth)
    with pytest.raises(InvalidInputError, match=r"^evidence\[0\]: got depths \S+ times as far as vehicles look"):
        reconstruct_scene(seen, CAMERA, evidence=[given], options=OPTIONS)
    with pytest.raises(InvalidInputError, match="--depth-per-metre"):
        reconstruct(seen[0], CAMERA, evidence=[given], options=OPTIONS)


def test_sure_pixels_free_the_size_and_others_do_not(street: tuple[list[Observation], np.ndarray]) -> None:
    seen, depth = street
    setup = SolveSetup.of(PRIOR, "kitti", OPTIONS, 1.65)
    maps = [DepthMap(depth, relative_sigma=0.01), DepthMap(depth), DepthMap(depth, shared_sigma=0.01)]
    observations = [seen[0].with_evidence([one]) for one in maps]
    assert [setup.is_measured(one, CAMERA) for one in observations] == [True, False, False]


def test_an_error_that_all_pixels_share_is_found(street: tuple[list[Observation], np.ndarray]) -> None:
    seen, depth = street
    shifted = 1.0 / (1.0 / depth - 0.004)
    maps = [DepthMap(shifted, relative_sigma=0.01, shared_sigma=sigma) for sigma in (0.0, 0.005)]
    exact, open_ = (reconstruct_scene(seen, CAMERA, evidence=[one], **HOW).vehicles for one in maps)
    assert errors(list(open_)).mean() < 0.8 * errors(list(exact)).mean()
    scale, offset = open_[0].diagnostics.depth_scales[0]
    assert scale == pytest.approx(1.0, abs=1e-3)
    assert 0.001 < offset < 0.006


def test_what_is_known_of_a_shared_error_is_added(street: tuple[list[Observation], np.ndarray]) -> None:
    """Oracle: the map with that error taken out by hand."""
    seen, depth = street
    given = 1.0 / (1.0 / depth - 0.004)
    corrected = 1.0 / (1.0 / given + 0.0015)
    how: dict[str, Any] = {"sigma": 0.01 * depth, "relative_sigma": 0.0, "shared_sigma": 0.003}
    by_hand, known, inverse = (
        reconstruct_scene(seen, CAMERA, evidence=[one], **HOW).vehicles
        for one in (
            DepthMap(corrected, **how),
            DepthMap(given, shared_mean=0.0015, **how),
            DepthMap(1.0 / given, inverse=True, shared_mean=0.0015, **how | {"sigma": 0.01 / depth}),
        )
    )
    for a, b, c in zip(by_hand, known, inverse, strict=True):
        assert b.location == pytest.approx(a.location, abs=1e-6)
        assert c.location == pytest.approx(a.location, abs=2e-2)  # its pixels are as sure, but for the shift
        (scale, shift), (before, left) = b.diagnostics.depth_scales[0], a.diagnostics.depth_scales[0]
        assert scale == pytest.approx(before)
        assert shift == pytest.approx(left + 0.0015, abs=1e-6)  # of the numbers that were given
        assert c.diagnostics.depth_scales[0][1] == pytest.approx(shift, abs=3e-4)


def test_one_image_twice_says_what_it_says_once(street: tuple[list[Observation], np.ndarray]) -> None:
    """Also of what its pixels have wrong together, where images of a vehicle have all errors in common."""
    (one, *_), depth = street
    shifted = 1.0 / (1.0 / depth - 0.006)
    given = [DepthMap(shifted, relative_sigma=0.01, shared_sigma=0.003)]
    options = replace(OPTIONS, shape=replace(OPTIONS.shape, common_error=1.0))
    once = reconstruct(one, CAMERA, evidence=given, ground=1.65, options=options)
    twice = reconstruct_track([one, one], CAMERA, evidence=[given, given], ground=1.65, options=options)
    assert twice.frames[0].location == pytest.approx(once.location, abs=2e-3)
    assert twice.frames[0].diagnostics.depth_scales == pytest.approx(once.diagnostics.depth_scales, abs=1e-5)


def test_one_vehicle_over_images_and_over_time(street: tuple[list[Observation], np.ndarray]) -> None:
    (one, *_), depth = street
    given = DepthMap(2.5 * depth, relative_sigma=0.01, scale=DepthScale.SCALE)
    single = reconstruct(one, CAMERA, evidence=[given], **HOW)
    assert np.linalg.norm(single.location - PLACES[0]) < 0.6
    track = reconstruct_track([one, one], CAMERA, evidence=[[given], [given]], **HOW)
    assert np.linalg.norm(track.frames[0].location - PLACES[0]) < 0.6
    tracker = Tracker()
    for time in (0.0, 0.1):
        found = tracker.update(time, {3: one}, camera=CAMERA, ground=1.65, evidence=[given])
    assert np.linalg.norm(found[3].reconstruction.location - PLACES[0]) < 0.6


def test_a_tracker_keeps_of_a_map_what_its_vehicles_use(street: tuple[list[Observation], np.ndarray]) -> None:
    seen, depth = street
    tracker = Tracker()
    given = DepthMap(depth, sigma=np.full(depth.shape, 0.05), shared_sigma=0.002)
    tracker.update(0.0, dict(enumerate(seen)), camera=CAMERA, ground=1.65, evidence=[given])
    for name, one in enumerate(seen):
        own = with_its_points(one.with_evidence([given]), CAMERA)
        (part,) = own.evidence
        (kept,) = tracker._tracks[name].vehicle.past[-1].problem.observation.evidence
        assert isinstance(part, DepthMap)
        assert isinstance(kept, DepthMap)
        assert part.corner == kept.corner
        assert np.array_equal(part.depth, kept.depth, equal_nan=True)
        assert kept.depth.base is None
        assert part.depth.size < 0.3 * depth.size
        again = with_its_points(own, CAMERA).evidence[0]
        assert isinstance(again, DepthMap)
        assert again.corner == part.corner
        setup = SolveSetup.of("car14", None, OPTIONS)
        whole, some = (point_terms(o, CAMERA, setup.model)[0] for o in (one.with_evidence([given]), own))
        assert np.array_equal(whole.rows.points, some.rows.points)
        assert np.array_equal(whole.rows.along, some.rows.along)
    beside = with_its_points(replace(seen[0], box=np.array([-90.0, -90.0, -50.0, -50.0]), evidence=(given,)), CAMERA)
    assert point_terms(beside, CAMERA, setup.model) == ()


def test_a_map_that_says_nothing_changes_nothing(street: tuple[list[Observation], np.ndarray]) -> None:
    (one, *_), depth = street
    alone = reconstruct(one, CAMERA, **HOW)
    empty = DepthMap(np.full(depth.shape, np.nan), scale=DepthScale.SCALE)
    assert np.array_equal(reconstruct(one, CAMERA, evidence=[empty], **HOW).camera_T_object, alone.camera_T_object)
    off = replace(OPTIONS, disabled_terms={*OPTIONS.disabled_terms, "depth"})
    left = reconstruct(one, CAMERA, evidence=[DepthMap(depth)], **HOW | {"options": off})
    assert np.array_equal(left.camera_T_object, alone.camera_T_object)


def test_what_does_not_fit_is_refused(street: tuple[list[Observation], np.ndarray]) -> None:
    (one, *_), depth = street
    with pytest.raises(InvalidInputError, match=r"evidence\[0\].*depth map of shape"):
        reconstruct(one, CAMERA, evidence=[DepthMap(depth[:-1])])
    pair = StereoPair(np.zeros((190, 620, 3), np.uint8), CAMERA, _shifted())
    with pytest.raises(InvalidInputError, match=r"evidence\[0\].*left image"):
        reconstruct(one, CAMERA, evidence=[pair])


def _shifted() -> np.ndarray:
    motion = np.eye(4)
    motion[0, 3] = -0.5
    return motion
