"""Photographs seen again from further away, against the renderer's picture from there."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from fgrecon.core.camera import Camera
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.images import write_png
from fgrecon.simulation.render import Body, render
from fgrecon_research.training.keypoints.dataset import Photographs, check_prepared, prepare_photographs
from fgrecon_research.training.keypoints.distant import SolidCar, distant_view, dolly_zoom, random_distant_view
from fgrecon_research.training.keypoints.labels import Labels, ShapeFit, project_labels
from fgrecon_research.training.keypoints.posed_cars import PosedCar

from .support import made_up_cars, unit_car_prior

FIT = ShapeFit(np.zeros(5), np.zeros((14, 3)), np.zeros((0, 4)))


@pytest.fixture(scope="module")
def prior():
    return unit_car_prior()


def painted(points, normals):
    """Colours that change slowly along the car, and from its left to its right."""
    waves = 0.5 + 0.4 * np.sin(points @ np.array([[9.0, 3.0, 1.0], [2.0, 11.0, 4.0], [1.0, 5.0, 13.0]]) * 1.5)
    return waves, np.zeros(len(points))


def photograph(prior, car):
    """The picture of a car, and the mask of where it is."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = car.rotation, car.translation
    surface = prior.surface
    body = Body(surface.vertices(np.zeros(5)), surface.faces, painted, pose)
    width, height = car.size
    picture = render([body], Camera(car.matrix), np.full((height, width, 3), 0.5))
    return picture.image, np.where(picture.body >= 0, 255, 0).astype(np.uint8)


@pytest.mark.parametrize("number", range(4))
def test_it_is_what_a_camera_there_would_see(prior, number):
    car = made_up_cars(prior, np.zeros(5), 4, np.random.default_rng(5))[number]
    image, mask = photograph(prior, car)
    surface = prior.surface
    distant = distant_view(image, mask, car, SolidCar(surface.vertices(np.zeros(5)), surface.faces), 4.0, 200)
    expected, outline = photograph(prior, distant.car)
    assert distant.image.shape == expected.shape
    both = (outline > 0) & (distant.mask > 127)
    assert both.sum() > 0.97 * (outline > 0).sum()
    # What the photograph shows from neither side is made up, and light comes from one side.
    away = np.abs(distant.image.astype(float) - expected)[both].max(axis=1)
    assert np.median(away) < 8
    assert (away > 40).mean() < 0.12 + distant.made_up


def test_the_direction_stays_and_the_image_is_filled(prior):
    vertices = prior.surface.vertices(np.zeros(5))
    for car in made_up_cars(prior, np.zeros(5), 5, np.random.default_rng(1)):
        far = dolly_zoom(car, vertices, 3.0, 192)
        assert far.azimuth == pytest.approx(car.azimuth)
        assert np.linalg.norm(far.translation) == pytest.approx(3.0 * np.linalg.norm(car.translation))
        pixels = far.project(vertices)
        np.testing.assert_allclose([pixels.min(axis=0), pixels.max(axis=0)], far.box.reshape(2, 2), atol=1.0)
        assert max(far.size) == 192


def test_from_the_same_distance_nothing_changes(prior):
    (car,) = made_up_cars(prior, np.zeros(5), 1, np.random.default_rng(2))
    image, mask = photograph(prior, car)
    surface = prior.surface
    same = distant_view(image, mask, car, SolidCar(surface.vertices(np.zeros(5)), surface.faces), 1.0, max(car.size))
    np.testing.assert_allclose(same.car.matrix, car.matrix, rtol=1e-2)
    assert same.made_up == 0.0
    assert same.scale == pytest.approx(1.0, abs=0.01)
    inside = (mask > 0) & (same.mask > 0)
    assert np.median(np.abs(same.image.astype(float) - image)[inside]) < 3


def test_what_was_taken_from_afar_is_not_taken_again(prior):
    (car,) = made_up_cars(prior, np.zeros(5), 1, np.random.default_rng(2))
    image, mask = photograph(prior, car)
    far = replace(car, translation=car.translation * 10)
    assert random_distant_view(image, mask, far, FIT, prior, 192, np.random.default_rng(0)) is None


def test_little_of_a_distant_car_is_made_up(prior):
    rng = np.random.default_rng(3)
    cars = made_up_cars(prior, np.zeros(5), 6, rng)
    drawn = [random_distant_view(*photograph(prior, car), car, FIT, prior, 96, rng) for car in cars]
    made = [d for d in drawn if d is not None]
    assert made
    assert all(d.made_up <= 0.1 and np.linalg.norm(d.car.translation) > 1.2 for d in made)


def test_prepared_photographs_have_distant_ones_whose_labels_follow(prior, tmp_path):
    cars = made_up_cars(prior, np.zeros(5), 3, np.random.default_rng(4), tmp_path)
    drawn = []
    for car in cars:
        image, mask = photograph(prior, car)
        write_png(car.image, image)
        drawn.append(tmp_path / f"mask-{car.image.name}")
        write_png(drawn[-1], np.repeat(mask[..., None], 3, axis=2))
    prepare_photographs(cars, [FIT] * 3, prior, tmp_path / "p", [drawn[0], drawn[1], None])
    labels = project_labels(prior, FIT, cars)
    photographs = Photographs.load(tmp_path / "p", labels, cars)
    rows = photographs.with_distant(np.arange(3))
    assert rows.tolist() == [0, 1, 2, 3, 4]  # nothing tells where the third car is in its photograph
    view = photographs.view(4)
    assert view.azimuth == pytest.approx(cars[1].azimuth)
    assert max(view.image.shape) == 192
    shown = view.visible > 0.5
    at = np.rint(view.keypoints[shown]).astype(int)
    around = cv2.dilate(view.mask, np.ones((11, 11), dtype=np.uint8))  # corners lie a little beside the outline
    assert (around[at[:, 1], at[:, 0]] > 127).all()
    beside = Labels(labels.keypoints + np.array([3.0, -2.0]), labels.visible)
    moved = Photographs.load(tmp_path / "p", beside, cars)
    step = (moved.keypoints - photographs.keypoints)[4]
    np.testing.assert_allclose(step, np.broadcast_to(step[0], step.shape), atol=1e-9)
    np.testing.assert_allclose(step[0, 0] / step[0, 1], -1.5)
    assert 0.3 < step[0, 0] / 3.0 < 3.0
    (tmp_path / "p" / "distant.npz").unlink()
    with pytest.raises(InvalidInputError, match=r"distant\.npz"):
        check_prepared(tmp_path / "p")


def test_mirrors_that_the_photograph_hides_are_drawn(prior):
    """Stubs beside the middle of a car, seen from right behind it: from nearby, its rear hides them."""
    vertices, faces = prior.surface.vertices(np.zeros(5)), prior.surface.faces
    behind, away = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]), np.array([0.0, 0.0, 1.0])
    matrix = np.array([[250.0, 0.0, 100.0], [0.0, 250.0, 90.0], [0.0, 0.0, 1.0]])
    car = PosedCar(Path("behind.png"), (200, 160), "shape", matrix, behind, away)
    assert abs(car.azimuth) == pytest.approx(np.pi)
    image, mask = photograph(prior, car)
    mirrors = prior.mean[prior.category.off_faces]
    plain = distant_view(image, mask, car, SolidCar(vertices, faces), 6.0, 192)
    distant = distant_view(image, mask, car, SolidCar(vertices, faces, mirrors, 0.0), 6.0, 192)
    np.testing.assert_array_equal(distant.car.matrix, plain.car.matrix)  # it is the body that fills the image
    black = (distant.image == 0).all(axis=2) & ~(plain.image == 0).all(axis=2)
    assert black.any()
    assert distant.valid[black].all()
    assert (distant.mask[black] == 255).all()
    row, column = np.nonzero(black)
    away = np.linalg.norm(np.stack([column, row], axis=1)[:, None] - distant.car.project(mirrors), axis=2).min(axis=1)
    assert away.max() < 0.03 * distant.car.matrix[0, 0] / np.linalg.norm(distant.car.translation)
    away = np.abs(distant.image.astype(int) - plain.image)[~black].max(axis=1)
    assert (away < 40).mean() > 0.97  # and nothing else changes much


def test_labels_are_believed_where_the_photograph_tells(prior):
    (car,) = made_up_cars(prior, np.zeros(5), 1, np.random.default_rng(2))
    image, mask = photograph(prior, car)
    surface = prior.surface
    distant = distant_view(image, mask, car, SolidCar(surface.vertices(np.zeros(5)), surface.faces), 4.0, 200)
    row, column = np.nonzero(distant.valid)
    middle = len(row) // 2
    places = np.array([[column[middle], row[middle]], [-50.0, -50.0]], dtype=float)
    assert distant.believes(places).tolist() == [True, False]
    blind = replace(distant, valid=np.zeros_like(distant.valid))
    assert not blind.believes(places).any()
