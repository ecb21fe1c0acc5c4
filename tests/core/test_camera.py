"""The camera against OpenCV and plain formulas; the ground plane."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import InvalidInputError

MATRIX = np.array([[721.5, 3.7, 609.6], [0.0, 718.9, 172.9], [0.0, 0.0, 1.0]])  # with a skew
LENSES = {
    4: [-0.31, 0.11, 0.0012, -0.0007],
    5: [-0.31, 0.11, 0.0012, -0.0007, -0.02],
    8: [0.2, -0.1, 0.001, 0.002, 0.01, 0.25, -0.08, 0.005],
    12: [-0.2, 0.05, 0.001, 0.001, 0.0, 0.01, 0.0, 0.0, 0.001, 0.0002, -0.001, 0.0001],
    14: [-0.2, 0.05, 0.001, 0.001, 0.0, 0.01, 0.0, 0.0, 0.001, 0.0002, -0.001, 0.0001, 0.01, -0.008],
}
points = arrays(np.float64, (7, 3), elements=st.floats(-20, 20)).map(lambda p: p * [1, 0.3, 1] + [0, 0, 25])
shared = settings(deadline=None, derandomize=True, max_examples=50)


def grid():
    """Pixels over most of KITTI's image."""
    u, v = np.meshgrid(np.linspace(50, 1190, 12), np.linspace(20, 350, 6))
    return np.stack([u.ravel(), v.ravel()], axis=1)


@given(points)
@shared
def test_rays_undo_the_projection(points):
    camera = Camera(MATRIX)
    rays = camera.rays(camera.project(points))
    np.testing.assert_array_equal(rays[:, 2], 1.0)
    np.testing.assert_allclose(rays * points[:, 2:], points, atol=1e-11)


def test_projection_by_hand_with_a_skew():
    u, v = Camera(MATRIX).project([2.0, -1.0, 10.0])
    assert u == pytest.approx(721.5 * 0.2 + 3.7 * -0.1 + 609.6)
    assert v == pytest.approx(718.9 * -0.1 + 172.9)
    assert Camera(MATRIX).project(np.ones((2, 4, 3))).shape == (2, 4, 2)


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)
def test_distortion_is_opencvs(lens):
    """OpenCV has no skew: compare without."""
    matrix = MATRIX * [[1, 0, 1], [1, 1, 1], [1, 1, 1]]
    camera = Camera(matrix, np.array(lens))
    in_camera = camera.rays(grid()) * 12.5
    theirs = cv2.projectPoints(in_camera, np.zeros(3), np.zeros(3), matrix, np.array(lens))[0][:, 0]
    np.testing.assert_allclose(camera.distort(camera.project(in_camera)), theirs, atol=1e-9)
    assert np.abs(theirs - grid()).max() > 5  # the lens does something


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)
@pytest.mark.parametrize("skew", [0.0, 3.7])
def test_undistortion_undoes_distortion(lens, skew):
    matrix = MATRIX.copy()
    matrix[0, 1] = skew
    camera = Camera(matrix, np.array(lens))
    np.testing.assert_allclose(camera.undistort(camera.distort(grid())), grid(), atol=1e-6)


def test_missing_pixels_stay_missing_and_the_input_is_not_changed():
    camera, pixels = Camera(MATRIX, np.array(LENSES[5])), grid()[:3]
    pixels[1] = np.nan
    before = pixels.copy()
    ideal = camera.undistort(pixels)
    np.testing.assert_array_equal(np.isnan(ideal), np.isnan(pixels))
    np.testing.assert_array_equal(pixels, before)
    assert camera.undistort(np.zeros((0, 2))).shape == (0, 2)
    assert np.isnan(camera.undistort(np.full((2, 2), np.nan))).all()


def test_without_distortion_pixels_are_ideal():
    camera = Camera(MATRIX, np.zeros(5))
    assert camera.distortion is None
    np.testing.assert_array_equal(camera.undistort(grid()), grid())
    np.testing.assert_array_equal(camera.distort(grid()), grid())


def test_every_way_to_give_a_camera():
    four = Camera.of([700, 710, 600, 180])
    np.testing.assert_array_equal(four.matrix, [[700, 0, 600], [0, 710, 180], [0, 0, 1]])
    np.testing.assert_array_equal(Camera.of(four.matrix.tolist()).matrix, four.matrix)
    assert Camera.of(four) is four
    np.testing.assert_array_equal(Camera.of(four.matrix, LENSES[4]).distortion, LENSES[4])
    lens = Camera.of(four, LENSES[5])  # a lens given beside a camera counts
    np.testing.assert_array_equal(lens.distortion, LENSES[5])
    np.testing.assert_array_equal(lens.matrix, four.matrix)


@pytest.mark.parametrize(
    "matrix",
    [
        np.zeros((3, 3)),
        np.diag([700.0, -700.0, 1.0]),
        np.diag([700.0, 700.0, 2.0]),
        np.diag([1e12, 700.0, 1.0]),
        np.diag([1e-12, 700.0, 1.0]),
        MATRIX.T,
        np.where(MATRIX == 3.7, np.nan, MATRIX),
        np.eye(4),
        [1.0, 2.0, 3.0],
        [700.0, 0.0, 600.0, 180.0],
        [700.0, np.inf, 600.0, 180.0],
        "K",
    ],
    ids=lambda m: str(np.shape(m)),
)
def test_unusable_intrinsics_are_named(matrix):
    with pytest.raises(InvalidInputError) as caught:
        Camera.of(matrix)
    assert caught.value.field.split("[")[0] == "intrinsics"


@pytest.mark.parametrize("lens", [[0.1], [0.1] * 6, [[0.1] * 5], [0.1, np.nan, 0, 0], "lens"], ids=str)
def test_unusable_distortion_is_named(lens):
    with pytest.raises(InvalidInputError) as caught:
        Camera.of(MATRIX, lens)
    assert caught.value.field.split("[")[0] == "distortion"


def test_ground_is_normalised():
    ground = Ground(np.array([0.0, 2.0, -0.2]), 1.65)
    assert np.linalg.norm(ground.normal) == pytest.approx(1.0)
    np.testing.assert_allclose(ground.normal * np.hypot(2.0, 0.2), [0.0, 2.0, -0.2])
    np.testing.assert_array_equal(Ground.level(1.5).normal, [0, 1, 0])
    assert Ground.level(1.5).distance == 1.5


def test_upright_turns_the_cameras_y_axis_onto_the_normal():
    ground = Ground(np.array([0.1, 2.0, -0.2]), 1.65)
    np.testing.assert_allclose(ground.upright[:, 1], ground.normal, atol=1e-15)
    np.testing.assert_allclose(ground.upright @ ground.upright.T, np.eye(3), atol=1e-15)
    np.testing.assert_array_equal(Ground.level(1.65).upright, np.eye(3))


def test_height_sigma_grows_with_the_depth():
    ground = Ground.level(1.65)
    np.testing.assert_allclose(ground.height_sigma_at(np.array([0.0, 40.0])), [0.1, np.hypot(0.1, 0.5)])


@pytest.mark.parametrize(
    ("field", "arguments"),
    [
        ("ground.normal", (np.zeros(3), 1.6)),
        ("ground.normal", (np.array([0.0, -1.0, 0.0]), 1.6)),
        ("ground.normal", (np.ones(2), 1.6)),
        ("ground.distance", (np.array([0.0, 1.0, 0.0]), 0.0)),
        ("ground.distance", (np.array([0.0, 1.0, 0.0]), np.nan)),
        ("ground.height_sigma", (np.array([0.0, 1.0, 0.0]), 1.6, 0.0)),
        ("ground.slope_sigma", (np.array([0.0, 1.0, 0.0]), 1.6, 0.1, -1.0)),
        ("ground.tilt_sigma", (np.array([0.0, 1.0, 0.0]), 1.6, 0.1, 0.01, np.inf)),
    ],
)
def test_unusable_ground_is_named(field, arguments):
    with pytest.raises(InvalidInputError) as caught:
        Ground(*arguments)
    assert caught.value.field == field


def test_a_camera_of_a_field_of_view():
    camera = Camera.of_field_of_view(800, 600, 90.0)
    np.testing.assert_allclose(camera.matrix, [[400.0, 0, 399.5], [0, 400.0, 299.5], [0, 0, 1]])
    assert camera.image_size == (800, 600)
    left, right = camera.rays(np.array([[-0.5, 299.5], [799.5, 299.5]]))
    assert np.degrees(np.arctan2(right[0], 1) - np.arctan2(left[0], 1)) == pytest.approx(90.0)
    assert Camera.of_field_of_view(800, 600).matrix[0, 0] == pytest.approx(400 / np.tan(np.pi / 6))


@pytest.mark.parametrize(("size", "degrees"), [((0, 600), 60.0), ((800, 600), 180.0), ((800, 600), 0.0)])
def test_fields_of_view_that_are_none(size, degrees):
    with pytest.raises(InvalidInputError):
        Camera.of_field_of_view(*size, degrees)


def test_a_part_of_the_image_sees_the_same():
    whole = replace(Camera.of([700.0, 710.0, 600.0, 180.0], [-0.3, 0.1, 0.001, 0.0]), image_size=(1242, 375))
    part = whole.cropped(200, 50, 640, 300)
    points = np.array([[1.0, 0.5, 8.0], [-2.0, 1.0, 12.0]])
    np.testing.assert_allclose(part.project(points), whole.project(points) - [200, 50], atol=1e-9)
    seen = whole.distort(whole.project(points))
    np.testing.assert_allclose(part.undistort(seen - [200, 50]), whole.undistort(seen) - [200, 50], atol=1e-6)
    assert part.image_size == (640, 300)
    assert whole.cropped(0, 0).image_size is None


@pytest.mark.parametrize(
    "part", [(-1, 0, 10, 10), (1240, 0, 10, 10), (0, 400), (float("nan"), 0), (0, 0, 10, 0.5), (True, 0)]
)
def test_a_part_outside_the_image_is_refused(part):
    with pytest.raises(InvalidInputError):
        Camera.of_field_of_view(1242, 375).cropped(*part)


def test_a_camera_is_not_as_high_as_a_mountain():
    """Millimetres and centimetres are distinguished from metres; what is estimated may be anything."""
    for height in (1650.0, 165.0):
        with pytest.raises(InvalidInputError, match=r"ground\.distance: got 1650?\.0\. .* in metres, at most 100"):
            Ground.level(height)
        with pytest.raises(InvalidInputError, match="in metres"):
            Ground(np.array([0.0, 1.0, 0.0]), height).as_given()
    assert Ground.level(99.0).distance == 99.0


def test_a_camera_of_another_resolution_is_refused():
    camera = Camera(MATRIX, image_size=(1242, 375))
    for height, width in ((375, 1242), (370, 1224)):  # KITTI's, and as it is cropped now and then
        assert camera.with_size_of(np.zeros((height, width, 3))).image_size == (width, height)
    for height, width in ((187, 621), (375, 1100), (750, 2484)):
        with pytest.raises(InvalidInputError, match="1242 x 375"):
            camera.with_size_of(np.zeros((height, width, 3)))
    assert Camera(MATRIX).with_size_of(np.zeros((9, 7, 3))).image_size == (7, 9)


def test_a_resized_image_has_the_corners_of_its_own():
    """As cv2.resize makes it: each pixel of the new image covers as much of the old one."""
    own = (1242, 375)
    whole = Camera(np.array([[700.0, 2.0, 600.0], [0.0, 710.0, 180.0], [0.0, 0.0, 1.0]]), [0.1, 0, 0, 0], own)
    points = np.array([[1.0, 0.5, 8.0], [-3.0, 1.0, 20.0]])
    small = whole.resized(621, 125)
    assert small.image_size == (621, 125)
    np.testing.assert_allclose(small.project(points), (whole.project(points) + 0.5) * [1 / 2, 1 / 3] - 0.5)
    np.testing.assert_allclose(small.resized(*own).matrix, whole.matrix)
    with pytest.raises(InvalidInputError, match="knows the size"):
        Camera.of([700.0, 700.0, 600.0, 180.0]).resized(621, 188)
    with pytest.raises(InvalidInputError, match="image_size"):
        whole.resized(0, 188)
