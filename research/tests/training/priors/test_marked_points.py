"""Points that people marked, located on car models: made-up models where the truth is known, and ApolloCar3D."""

import numpy as np
import pytest

import fgrecon
from fgrecon.core.camera import Camera
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import MIRROR, yaw_rotation
from fgrecon.io.catalogue import load_category, load_prior
from fgrecon_research.evaluation.measures import rotation_error
from fgrecon_research.paper.apollocar3d import read_apollocar3d
from fgrecon_research.paper.known_shape import KNOWN_SHAPE_OPTIONS
from fgrecon_research.training.priors.apollo79 import Apollo79, load_apollo79, rounded
from fgrecon_research.training.priors.marked_points import PosedMarks, located_points, marked_prior

CAMERA = Camera.of([900.0, 900.0, 500.0, 400.0])
CATEGORY = load_category("pascal12")
OFFSET = np.array([0.03, -0.02, 0.04])


def made_up(rng, count=5):
    """Models of 40 vertices in one topology, and 12 points: vertices with one offset, those on the right mirrored."""
    base = rng.uniform([-2, -1.5, 0.2], [2, -0.2, 0.9], (40, 3))
    vertices = base * rng.uniform(0.9, 1.1, (count, 1, 3))
    left = [k for k, mirror in enumerate(CATEGORY.mirror) if k < mirror]
    points = np.zeros((count, CATEGORY.size, 3))
    for place, k in enumerate(left):
        points[:, k] = vertices[:, 5 * place] + OFFSET
        points[:, CATEGORY.mirror[k]] = points[:, k] * MIRROR
    nothing = np.zeros((count, 14, 3))
    names = tuple(f"m{i}" for i in range(count))
    models = Apollo79(
        names, nothing, nothing, vertices, vertices, np.zeros((1, 3), np.int32), np.ones((count, 3)), np.ones(count)
    )
    return models, points


def seen(rng, model, points):
    """A car's marks from somewhere, half of them missing."""
    pose = np.eye(4)
    pose[:3, :3] = yaw_rotation(rng.uniform(-3, 3))
    pose[:3, 3] = rng.uniform([-3, 1, 8], [3, 2, 15])
    pixels = CAMERA.project(points[model] @ pose[:3, :3].T + pose[:3, 3])
    pixels[rng.random(len(pixels)) < 0.5] = np.nan
    return PosedMarks(model, pixels, pose)


def test_points_are_found_and_imputed():
    rng = np.random.default_rng(0)
    models, points = made_up(rng)
    points[1, 0] += [0.06, 0.0, 0.0]  # one point of one model lies elsewhere
    points[1, CATEGORY.mirror[0]] = points[1, 0] * MIRROR
    cars = [seen(rng, model, points) for model in range(4) for _ in range(20)]
    found = located_points(cars, CAMERA, models, CATEGORY)
    assert np.array_equal(found.points, found.points[:, CATEGORY.mirror] * MIRROR)
    off = np.linalg.norm(found.points - points, axis=2)
    first = [0, CATEGORY.mirror[0]]
    assert off[:, first].max() < 0.02  # of 6 cm: held by the Gaussian, and the others drawn a little
    assert np.delete(off, first, axis=1).max() < 0.002
    assert (found.marks[4] == 0).all()  # no car of the last model: where the others have it
    assert (found.marks[:4] > 5).all()
    assert found.residual.max() < 0.01


def test_too_few_marks():
    rng = np.random.default_rng(1)
    models, points = made_up(rng)
    with pytest.raises(InvalidInputError, match="marks of left_front_wheel"):
        located_points([seen(rng, 0, points)], CAMERA, models, CATEGORY)


@pytest.fixture(scope="module")
def apollo(data):
    models = load_apollo79(data)
    return models, read_apollocar3d(data / "apollocar3d_val" / "annotations.json", models)


def learnt(apollo, category, without=None):
    """The prior from all drives but one."""
    models, found = apollo
    cars = [
        PosedMarks(models.names.index(car.model), car.all_marks, car.camera_T_object)
        for car in found.cars
        if without is None or not car.name.startswith(without)
    ]
    located = located_points(cars, found.camera, models, load_category("apollo66"))
    return marked_prior(located, models, load_category(category))


@pytest.mark.data
@pytest.mark.parametrize("category", ["apollo66", "apollo24", "pascal12"])
def test_the_shipped_priors_are_made_again(apollo, category):
    shipped, made = load_prior(category), rounded(learnt(apollo, category))
    for field in ("mean", "basis", "offset_sigma", "explained"):
        assert np.abs(getattr(shipped, field) - getattr(made, field)).max() < 2e-6
    assert np.abs(shipped.surface.mean - made.surface.mean).max() < 2e-6
    assert dict(shipped.provenance) == dict(made.provenance)
    assert shipped.category.to_dict() == load_category(category).to_dict()


@pytest.mark.data
@pytest.mark.slow
def test_more_points_on_a_drive_that_was_not_learnt_from(apollo):
    """With the size known, as fgrecon cannot see it, 66 points are better than 14 in rotation and position."""
    _, found = apollo
    drive = "180116"
    cars = [car for car in found.cars if car.name.startswith(drive)][::3][:40]
    errors = {}
    for name, prior in (("car14", load_prior("car14")), ("apollo66", learnt(apollo, "apollo66", drive))):
        rows = []
        for car in cars:
            points = car.keypoints if name == "car14" else car.all_marks
            size = fgrecon.SizePrior("true", car.size, 0.02 * car.size)
            arguments = {"prior": prior, "options": KNOWN_SHAPE_OPTIONS, "size_prior": size}
            pose = fgrecon.reconstruct(points, found.camera, **arguments).camera_T_object
            true = car.camera_T_object
            turn = rotation_error(pose[None, :3, :3], true[None, :3, :3])[0]
            rows.append((turn, np.linalg.norm(pose[:3, 3] - true[:3, 3]) / car.distance))
        errors[name] = np.median(rows, axis=0)
    assert (errors["apollo66"] < errors["car14"]).all(), errors
