"""What the files of the authors' release mean, shown on real cars and the two labelled images."""

import json
import shutil

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.size_prior import SizePrior
from fgrecon.io.catalogue import load_category
from fgrecon_research.paper.icra2017 import (
    AVERAGE_CAR,
    import_icra2017,
    load_icra2017_example,
)
from fgrecon_research.training.priors.apollo79 import DUPLICATE

pytestmark = pytest.mark.data
CATEGORY = load_category("car36")
LEFT = np.arange(18)
COLOUR_CAMERA = np.array([0.0599, -0.0004, 0.0027])
"""K^-1 P2[:, 3] of the sequences that the images come from: what takes a label to the colour camera's frame."""


@pytest.fixture(scope="module")
def folder(data):
    return data / "icra2017"


@pytest.fixture(scope="module")
def prior(folder):
    return import_icra2017(folder)


@pytest.fixture(scope="module")
def cars(data):
    """Real cars in the same 36 points, at their real size; each car once."""
    with np.load(data / "apollo79" / "apollo79_car36.npz") as archive:
        names = [str(name) for name in archive["car_names"]]
        length = archive["dims"][:, 0]
        scale = np.where(archive["scale_suspect"], archive["real_length_m"] / length, 1.0)
        size = np.column_stack([length, archive["body_width"], archive["dims"][:, 2]]) * scale[:, None]
        keypoints = archive["keypoints"] * scale[:, None, None]
        assert [name[0] for name in archive["names"]] == ["L"] * 18 + ["R"] * 18
        assert (archive["symmetric_keypoint_pairs"] == CATEGORY.symmetric_pairs).all()
    kept = np.array([name != DUPLICATE[1] for name in names])
    return keypoints[kept], size[kept]


def test_ratios_of_the_category_are_the_measured_ones(cars):
    keypoints, size = cars
    boxes = np.tensordot(keypoints, CATEGORY.dimension_operator, axes=([1, 2], [1, 2]))
    assert (boxes / size).mean(axis=0) == pytest.approx(np.ones(3), abs=1.5e-3)
    ground = -keypoints[:, list(CATEGORY.ground_keypoints), 1].mean(axis=1) / size[:, 2]
    assert CATEGORY.ground_ratio == pytest.approx(ground.mean(), abs=5e-4)


class TestPrior:
    def test_size_frame_and_symmetry(self, prior):
        assert (prior.dimension, prior.category.name, prior.surface) == (42, "car36", None)
        assert prior.is_symmetric
        assert prior.box_size(np.zeros(42)) == pytest.approx(AVERAGE_CAR.mean)
        assert (prior.mean[LEFT, 2] > 0.5).all()
        wheels = prior.mean[list(CATEGORY.ground_keypoints)]
        assert wheels[:, 1].mean() == pytest.approx(-0.213 * 1.5208)
        assert prior.mean[CATEGORY.index("left_front_wheel"), 0] > 1 > -1 > prior.mean[0, 0]

    def test_mean_is_that_of_real_cars(self, prior, cars):
        """Same places at the same size, origin included: 10 cm RMS along the car (rear roof 25), 4 across and up."""
        keypoints, size = cars
        fleet = prior.for_fleet(SizePrior("cars", size.mean(axis=0), size.std(axis=0)))
        rms = np.sqrt(((fleet.mean - keypoints.mean(axis=0)) ** 2).mean(axis=0))
        assert rms[0] < 0.11
        assert rms[1:].max() < 0.045
        assert np.abs(fleet.mean[:, 0].mean() - keypoints[..., 0].mean()) < 0.05

    def test_rows_hold_one_point_after_another(self, prior, folder):
        """Neighbours along the outline move alike; read as all x, then all y, then all z they do not."""
        pairs = [edge for edge in CATEGORY.edges if edge not in CATEGORY.symmetric_pairs]
        first, second = np.array(pairs).T

        def roughness(basis):
            return ((basis[:5, first] - basis[:5, second]) ** 2).sum() / (basis[:5] ** 2).sum()

        other = np.loadtxt(folder / "basisVectors.txt").reshape(42, 3, 36).transpose(0, 2, 1)
        assert roughness(prior.basis / np.linalg.norm(prior.basis, axis=(1, 2))[:, None, None]) < 0.6 * roughness(other)
        mirrored = np.abs(other[:, CATEGORY.mirror] * [1, 1, -1] - other).max()
        assert mirrored > 0.5

    def test_coefficients_are_variances(self, prior, cars, folder):
        """Real cars have unit variance in lambda; read as standard deviations, 20 times that."""
        keypoints, size = cars
        fleet = prior.for_fleet(SizePrior("cars", size.mean(axis=0), size.std(axis=0))).truncated(10)
        columns = (fleet.basis - fleet.basis.mean(axis=1, keepdims=True)).reshape(10, -1).T
        centred = keypoints - keypoints.mean(axis=1, keepdims=True) - (fleet.mean - fleet.mean.mean(axis=0))
        coefficients = np.linalg.lstsq(columns, centred.reshape(len(centred), -1).T, rcond=None)[0]
        assert np.sqrt((coefficients**2).mean()) == pytest.approx(1.1, abs=0.1)
        given = np.loadtxt(folder / "shapeCoefficientsInitial.txt")[:10, None]
        assert np.sqrt((coefficients**2 / given).mean()) > 15
        assert prior.explained == pytest.approx(np.loadtxt(folder / "shapeCoefficientsInitial.txt") / 0.0667, rel=0.01)

    def test_errors(self, folder, tmp_path):
        with pytest.raises(InvalidInputError, match=r"meanShape\.txt"):
            import_icra2017(tmp_path)
        for name in ("meanShape.txt", "basisVectors.txt", "shapeCoefficientsInitial.txt"):
            shutil.copy(folder / name, tmp_path / name)
        for name, text, said in (
            ("meanShape.txt", "1 2 3", "hold 108"),
            ("basisVectors.txt", "1 x", "no numbers"),
            ("shapeCoefficientsInitial.txt", "nan " * 42, "hold 42"),
            ("shapeCoefficientsInitial.txt", "-1 " * 42, "-1"),
        ):
            original = (tmp_path / name).read_bytes()
            (tmp_path / name).chmod(0o600)
            (tmp_path / name).write_text(text)
            with pytest.raises(InvalidInputError, match=said):
                import_icra2017(tmp_path)
            (tmp_path / name).write_bytes(original)


def wrap(angle):
    return (angle + np.pi) % (2 * np.pi) - np.pi


def project(camera, shape, rotation, translation):
    homogeneous = (shape @ rotation.T + translation) @ camera.matrix.T
    return homogeneous[:, :2] / homogeneous[:, 2:]


def yaw_rotation(rotation_y):
    return Rotation.from_euler("y", rotation_y).as_matrix()


def fit(example, prior, vectors):
    """Pose, and `vectors` coefficients, by robust least squares from the first azimuth guess; errors to the label."""
    truth = example.location + COLOUR_CAMERA
    start = [*Rotation.from_euler("y", example.azimuth).as_rotvec(), *(truth * 1.2), *np.zeros(vectors)]
    part = prior.truncated(vectors)

    def residuals(x):
        uv = project(example.camera, part.keypoints(x[6:]), Rotation.from_rotvec(x[:3]).as_matrix(), x[3:6])
        errors = (uv - example.observation.keypoints) / 4
        norms = np.linalg.norm(errors, axis=1, keepdims=True) + 1e-12
        return np.concatenate([(errors * np.sqrt(np.log1p(norms**2)) / norms).ravel(), x[6:]])

    x = least_squares(residuals, start).x
    rotation = Rotation.from_rotvec(x[:3]).as_matrix()
    yaw = np.degrees(wrap(np.arctan2(-rotation[2, 0], rotation[0, 0]) - example.rotation_y))
    uv = project(example.camera, part.keypoints(x[6:]), rotation, x[3:6])
    gap = np.median(np.linalg.norm(uv - example.observation.keypoints, axis=1))
    return abs(yaw), float(np.linalg.norm(x[3:6] - truth)), float(gap)


class TestExamples:
    @pytest.fixture(params=["01", "02"])
    def example(self, request, folder):
        return load_icra2017_example(folder, request.param)

    @pytest.fixture
    def fleet(self, example, prior):
        """The prior at the labelled size of the car."""
        return prior.for_fleet(SizePrior("label", example.size, np.full(3, 0.1)))

    def test_read(self, example):
        assert example.image.is_file()
        assert example.observation.keypoints.shape == (36, 2)
        box = example.observation.box
        assert (example.observation.keypoints > box[:2] - 2).all()
        assert (example.observation.keypoints < box[2:] + 2).all()
        assert example.cell * 64 == pytest.approx(box[2:] - box[:2])
        assert example.camera.matrix[0, 0] == pytest.approx(721.5377)

    def test_azimuth_is_rotation_y(self, example):
        assert abs(np.degrees(wrap(example.azimuth - example.rotation_y))) < 15

    def test_label_box_projects_into_the_box(self, example):
        """The label is the centre of the bottom face: the 3D box seen from there fills the 2D box."""
        length, width, height = example.size
        signs = np.array(np.meshgrid([-0.5, 0.5], [-1, 0], [-0.5, 0.5])).reshape(3, -1).T
        corners = signs * [length, height, width]
        centre = example.location + COLOUR_CAMERA
        uv = project(example.camera, corners, yaw_rotation(example.rotation_y), centre)
        assert np.concatenate([uv.min(axis=0), uv.max(axis=0)]) == pytest.approx(example.observation.box, abs=25)

    def test_first_half_is_the_left_side(self, example, fleet):
        """At the labelled pose the mean shape is seen where the network saw it, its mirror image is not."""
        rotation, centre = yaw_rotation(example.rotation_y), example.location + COLOUR_CAMERA
        seen = example.observation.keypoints[LEFT]  # both cars show their left side
        here = project(example.camera, fleet.mean, rotation, centre)
        gaps = [np.median(np.linalg.norm(uv - seen, axis=1)) for uv in (here[LEFT], here[LEFT + 18])]
        assert gaps[0] < 15
        assert gaps[1] > 1.5 * gaps[0]

    def test_pose_and_shape_fit(self, example, fleet):
        """Plain fits at the labelled size: 01 errs by 0.1 and 1.1 degrees, 02 (a car on a slope) by 8 and 5."""
        limit = 2.0 if example.image.parent.name == "01" else 8.5
        yaw, distance, gap = fit(example, fleet, 0)
        assert (yaw < limit, distance < 1.0, gap < 5.0) == (True, True, True)
        yaw, distance, better = fit(example, fleet, 42)
        assert (yaw < limit, distance < 1.0, better < 2.0) == (True, True, True)

    def test_own_scale(self, folder, prior):
        """Pose alone with the authors' average car: 4 degrees and 0.3 m on the first image."""
        yaw, distance, _ = fit(load_icra2017_example(folder, "01"), prior, 0)
        assert yaw < 5
        assert distance < 0.4

    def test_errors(self, folder, tmp_path):
        with pytest.raises(InvalidInputError, match="03"):
            load_icra2017_example(folder, "03")
        for name in ("intrinsics.txt", "examples/01/bbox.txt", "examples/01/keypoints.txt", "examples/01/azimuth.txt"):
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(folder / name, tmp_path / name)
        truth = tmp_path / "examples" / "ground_truth.json"
        with pytest.raises(InvalidInputError, match="ground_truth"):
            load_icra2017_example(tmp_path, "01")
        truth.write_text(json.dumps({"02": {}}))
        with pytest.raises(InvalidInputError, match="no entry 01"):
            load_icra2017_example(tmp_path, "01")
        (tmp_path / "examples/01/azimuth.txt").write_text("1 2")
        truth.write_text(json.dumps({"01": {}}))
        with pytest.raises(InvalidInputError, match="azimuth"):
            load_icra2017_example(tmp_path, "01")
