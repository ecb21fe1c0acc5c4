"""Silhouettes beside keypoints: shape and place of a vehicle, what hides it, several vehicles of an image."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from fgrecon import Mask, Observation, Options, Reconstruction, Status, reconstruct, reconstruct_scene
from fgrecon.errors import DegenerateProblemError, InvalidInputError
from fgrecon.io.catalogue import load_prior
from tests.cars import CAMERA as WHOLE
from tests.cars import observe, yaw_pose

CAMERA = replace(WHOLE, image_size=(1242, 375))
PRIOR = load_prior("car14")
SHAPE = np.array([1.2, 0.8, -0.6, 0.5, 0.3])
PLACES = [(1.5, 1.65, 11.0), (-3.0, 1.65, 14.0)]


def silhouette(pose: np.ndarray) -> np.ndarray:
    """(H, W) where the surface is."""
    assert PRIOR.surface is not None
    pixels = CAMERA.project(PRIOR.surface.vertices(SHAPE) @ pose[:3, :3].T + pose[:3, 3])
    filled = np.zeros((375, 1242), dtype=np.uint8)
    for face in PRIOR.surface.faces:
        cv2.fillConvexPoly(filled, np.round(pixels[face] * 16.0).astype(np.int32), 1, shift=4)
    return filled > 0


def off(found: Reconstruction, pose: np.ndarray) -> np.ndarray:
    """Metres of position, degrees of the rotation, metres of the size in the mean."""
    turn = np.trace(found.camera_T_object[:3, :3].T @ pose[:3, :3])
    angle = np.degrees(np.arccos(np.clip((turn - 1.0) / 2.0, -1.0, 1.0)))
    size = np.abs(found.box_size - PRIOR.box_size(SHAPE)).mean()
    return np.array([np.linalg.norm(found.location - pose[:3, 3]), angle, size])


def seen(yaw: float, place: tuple[float, ...], seed: int = 0) -> tuple[Observation, np.ndarray, np.ndarray]:
    pose = yaw_pose(yaw, place)
    return observe(PRIOR, pose, SHAPE, noise=2.0, seed=seed), silhouette(pose), pose


def test_a_silhouette_makes_size_and_rotation_better() -> None:
    errors: dict[bool, list[np.ndarray]] = {False: [], True: []}
    for i, yaw in enumerate(np.linspace(-2.5, 3.7, 24)):
        observation, mask, pose = seen(yaw, PLACES[0], seed=i)
        for masked in errors:
            found = reconstruct(observation, CAMERA, ground=1.65, evidence=[Mask(mask, sigma=0.7)] if masked else [])
            errors[masked].append(off(found, pose))
    before, after = (np.median(errors[masked], axis=0) for masked in (False, True))
    assert (after < before).all(), (before, after)
    assert (after[[0, 2]] < 0.6 * before[[0, 2]]).all(), (before, after)
    assert found.diagnostics.evidence["mask"] > 1.0  # times smaller is the position's standard deviation
    assert 0.0 < found.diagnostics.energies["mask"] < 20.0


@pytest.mark.parametrize("count", [0, 2])
@pytest.mark.parametrize("kernel", ["", "numpy"])
def test_a_silhouette_stands_in_for_keypoints(count: int, kernel: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Which a box alone does not: it tells neither the pose nor what is wrong with few keypoints."""
    monkeypatch.setenv("FGRECON_KERNEL", kernel)
    _, mask, pose = seen(-0.6, PLACES[0])
    keypoints = np.full((14, 2), np.nan)
    shown = [0, 3][:count]
    keypoints[shown] = CAMERA.project(PRIOR.keypoints(SHAPE)[shown] @ pose[:3, :3].T + pose[:3, 3])
    rows, columns = np.nonzero(mask)
    box = np.array([columns.min(), rows.min(), columns.max(), rows.max()], dtype=float)
    few = Observation.of(keypoints, None, box)
    with pytest.raises(DegenerateProblemError, match=r"keypoint"):
        reconstruct(few, CAMERA, ground=1.65)
    found = reconstruct(few, CAMERA, ground=1.65, evidence=[Mask(mask, sigma=0.7)])
    place, turned, _ = off(found, pose)
    assert place < 1.5
    assert min(turned, abs(180.0 - turned)) < 6.0  # which way it faces the outline does not say
    assert found.status is not Status.CONVERGED


def test_what_hides_a_vehicle_is_no_outline() -> None:
    observation, mask, pose = seen(-0.4, PLACES[0])
    middle = int(np.flatnonzero(mask.any(axis=0)).mean())
    post = np.zeros_like(mask)
    post[:, middle + 20 :] = True  # all of one side
    visible = Mask(mask & ~post, sigma=0.7)
    known = reconstruct(observation, CAMERA, ground=1.65, evidence=[visible, Mask(post, hides=True)])
    unknown = reconstruct(observation, CAMERA, ground=1.65, evidence=[visible])
    alone = reconstruct(observation, CAMERA, ground=1.65)
    assert off(known, pose)[0] < 1.1 * off(alone, pose)[0]
    assert off(unknown, pose)[0] < off(alone, pose)[0] + 0.5  # half of the rows are taken for wrong


def test_each_vehicle_of_an_image_takes_its_own() -> None:
    both = [seen(-0.4, PLACES[0]), seen(1.9, PLACES[1], seed=3)]
    masks = [Mask(mask, sigma=0.7) for _, mask, _ in both]
    scene = reconstruct_scene([one for one, _, _ in both], CAMERA, ground=1.65, evidence=masks)
    for (observation, _, pose), mask, found in zip(both, masks, scene.vehicles, strict=True):
        assert found.diagnostics.evidence["mask"] > 1.0
        alone = reconstruct(observation, CAMERA, ground=1.65, evidence=[mask])
        assert off(found, pose) == pytest.approx(off(alone, pose), abs=0.3)


def test_masks_of_others_change_nothing_and_say_so() -> None:
    observation, mask, _ = seen(-0.4, PLACES[0])
    elsewhere = Mask(np.roll(mask, 400, axis=1))
    alone = reconstruct(observation, CAMERA)
    found = reconstruct(observation, CAMERA, evidence=[elsewhere])
    assert np.array_equal(alone.camera_T_object, found.camera_T_object)
    assert any("masks: left out" in sentence for sentence in found.diagnostics.left_out)
    off_term = Options(disabled_terms={"mask", "laplacian", "planarity"})
    without = reconstruct(observation, CAMERA, options=off_term, evidence=[Mask(mask)])
    assert np.array_equal(alone.camera_T_object, without.camera_T_object)
    with pytest.raises(InvalidInputError, match=r"^mask.*\(375, 1242\)"):
        reconstruct(observation, CAMERA, evidence=[Mask(mask[:, :600])])
