"""Shape and poses from silhouettes."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.images import write_png
from fgrecon_research.training.keypoints.dataset import fill_faces
from fgrecon_research.training.keypoints.labelling import Source, first_labelling, open_photographs
from fgrecon_research.training.keypoints.labels import ShapeFit
from fgrecon_research.training.keypoints.silhouettes import Outline, contradicted, fit_outlines, read_outline
from research.tests.training.keypoints.support import made_up_cars, unit_car_prior

TRUTH = np.array([1.0, -0.8, 0.6, 0.3, -0.4])


@pytest.fixture(scope="module")
def prior():
    return unit_car_prior()


def silhouette(prior, car, coefficients=TRUTH):
    """The car as a segmentation would show it."""
    pixels = car.project(prior.surface.vertices(coefficients))
    return fill_faces(pixels[prior.surface.faces], max(car.size))[: car.size[1], : car.size[0]]


def start(count):
    return ShapeFit(np.zeros(5), np.zeros((14, 3)), np.zeros((count, 4)))


def moved(car, rng):
    """The photograph with a measured pose that is off."""
    turn = cv2.Rodrigues(rng.normal(0.0, 0.03, 3))[0]
    return replace(
        car, rotation=turn @ car.rotation, translation=car.translation + rng.normal(0, 1, 3) * [0.01, 0.01, 0.03]
    )


def test_shape_and_poses_are_found(prior):
    rng = np.random.default_rng(0)
    cars = made_up_cars(prior, TRUTH, 12, rng)
    outlines = [Outline.of(silhouette(prior, car)) for car in cars]
    result = fit_outlines(prior, [moved(car, rng) for car in cars], outlines, start(12))
    assert result.used.all()
    before, after = (
        np.linalg.norm(prior.keypoints(c) - prior.keypoints(TRUTH), axis=1).mean()
        for c in (np.zeros(5), result.fit.coefficients)
    )
    assert after < 0.25 * before
    extent = np.array([max(car.size) for car in cars])[:, None]
    points = prior.keypoints(TRUTH)
    found = prior.keypoints(result.fit.coefficients)
    off = [np.linalg.norm(c.project(found) - t.project(points), axis=1) for c, t in zip(result.cars, cars, strict=True)]
    assert np.median(np.array(off) / extent) < 0.01


def test_the_derivative_of_the_distance_is_the_numeric_one(prior):
    car = made_up_cars(prior, TRUTH, 1, np.random.default_rng(1))[0]
    outline = Outline.of(silhouette(prior, car))
    pixels = np.random.default_rng(2).uniform(20, 80, (50, 2))
    _, slope = outline.residuals(pixels)
    for axis, step in enumerate(np.eye(2)):
        numeric = (outline.residuals(pixels + step)[0] - outline.residuals(pixels - step)[0]) / 2
        assert np.median(np.abs(numeric - slope[:, axis])) < 2e-4


def test_a_silhouette_of_something_else_is_not_believed(prior):
    rng = np.random.default_rng(3)
    cars = made_up_cars(prior, np.zeros(5), 6, rng)
    outlines = [Outline.of(silhouette(prior, car, np.zeros(5))) for car in cars]
    other = np.zeros((cars[2].size[1], cars[2].size[0]), dtype=np.uint8)
    other[:20, :30] = 255
    outlines[2], outlines[4] = Outline.of(other), None
    result = fit_outlines(prior, cars, outlines, start(6))
    assert result.used.tolist() == [True, True, False, True, False, True]
    assert result.cars[2] is cars[2]
    assert np.abs(result.fit.coefficients).max() < 0.5


def test_the_projected_surface_meets_the_silhouette_without_bias(prior):
    rng = np.random.default_rng(6)
    cars = made_up_cars(prior, TRUTH, 16, rng)
    outlines = [Outline.of(silhouette(prior, car)) for car in cars]
    result = fit_outlines(prior, cars, outlines, ShapeFit(TRUTH, np.zeros((14, 3)), np.zeros((16, 4))))
    vertices = prior.surface.vertices(result.fit.coefficients)
    extent = np.ptp(vertices, axis=0) / np.ptp(prior.surface.vertices(TRUTH), axis=0)
    np.testing.assert_allclose(extent, 1.0, atol=0.006)
    size, true = ([c.matrix[0, 0] / np.linalg.norm(c.translation) for c in some] for some in (result.cars, cars))
    np.testing.assert_allclose(size, true, rtol=0.006)


def test_the_outline_tells_how_near_the_camera_was(prior):
    rng = np.random.default_rng(8)
    cars = made_up_cars(prior, TRUTH, 16, rng)
    outlines = [Outline.of(silhouette(prior, car)) for car in cars]
    factor = np.exp(rng.normal(0.0, 0.4, 16))
    measured = [car.zoomed(f) for car, f in zip(cars, factor, strict=True)]
    result = fit_outlines(prior, measured, outlines, ShapeFit(TRUTH, np.zeros((14, 3)), np.zeros((16, 4))))
    assert result.used.all()
    left = [c.matrix[0, 0] / t.matrix[0, 0] for c, t in zip(result.cars, cars, strict=True)]
    assert np.std(np.log(left)) < 0.4 * np.std(np.log(factor))


def test_keypoints_beyond_the_outline_are_contradicted(prior):
    cars = made_up_cars(prior, TRUTH, 8, np.random.default_rng(7))
    outlines = [Outline.of(silhouette(prior, car)) for car in cars]
    offsets = np.zeros((14, 3))
    offsets[12, 1] = -0.1  # left above the roof, right where it belongs
    keypoints = np.array([car.project(prior.keypoints(TRUTH, offsets)) for car in cars])
    mirror = prior.category.mirror
    assert contradicted(outlines, keypoints, mirror).nonzero()[0].tolist() == [12, 13]
    right = np.array([car.project(prior.keypoints(TRUTH)) for car in cars])
    assert not contradicted(outlines, right, mirror).any()
    assert not contradicted([*outlines[:4], *[None] * 4], keypoints, mirror).any()


def test_without_silhouettes_nothing_changes(prior):
    cars = made_up_cars(prior, np.zeros(5), 3, np.random.default_rng(4))
    result = fit_outlines(prior, cars, [None] * 3, start(3))
    assert not result.used.any()
    np.testing.assert_array_equal(result.fit.coefficients, np.zeros(5))


def test_files(tmp_path):
    assert read_outline(tmp_path / "none.png", (60, 40)) is None
    write_png(tmp_path / "empty.png", np.zeros((40, 60, 3), dtype=np.uint8))
    assert read_outline(tmp_path / "empty.png", (60, 40)) is None
    with pytest.raises(InvalidInputError, match="60 x 41"):
        read_outline(tmp_path / "empty.png", (60, 41))
    (tmp_path / "bad.png").write_bytes(b"no image")
    with pytest.raises(InvalidInputError, match=r"bad\.png"):
        read_outline(tmp_path / "bad.png", (60, 40))


def test_first_labels_trust_photographs_with_silhouettes(prior, tmp_path):
    cars = made_up_cars(prior, np.zeros(5), 5, np.random.default_rng(5))
    source = Source(cars, np.arange(5), np.arange(0), prior)
    with pytest.raises(InvalidInputError, match="silhouettes"):
        first_labelling(source, tmp_path)
    for car in cars[:3]:
        mask = silhouette(prior, car, np.zeros(5))
        write_png(tmp_path / f"{car.image.stem}.png", np.repeat(mask[..., None], 3, axis=2))
    labelling = first_labelling(source, tmp_path)
    assert labelling.trusted.tolist() == labelling.outlined.tolist() == [True, True, True, False, False]


def test_labels_that_silhouettes_contradict_are_left_out_and_masks_are_theirs(prior, tmp_path):
    cars = made_up_cars(prior, np.zeros(5), 6, np.random.default_rng(8), tmp_path)
    source = Source(cars, np.arange(6), np.arange(0), prior)
    for car in cars:
        mask = silhouette(prior, car, np.zeros(5))
        mask[: int(0.45 * len(mask))] = 0  # a car without a roof
        write_png(tmp_path / f"{car.image.stem}.png", np.repeat(mask[..., None], 3, axis=2))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fgrecon_research.training.keypoints.silhouettes._OVERLAP", 0.1)
        labelling = first_labelling(source, tmp_path)
    unknown = np.isnan(labelling.labels.keypoints).all(axis=(0, 2))
    assert unknown[10:].all()
    assert not unknown[:10].any()
    prepared = open_photographs(source, labelling, tmp_path / "work", tmp_path)
    view = prepared.view(0)
    assert not view.mask[: int(0.4 * len(view.mask))].any()
    assert view.mask.any()
