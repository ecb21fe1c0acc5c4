"""The renderer against rays solved triangle by triangle, and what a scene must show."""

from __future__ import annotations

import numpy as np
import pytest

from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.catalogue import load_prior
from fgrecon.simulation.render import Body, pixel_rays, rasterise, render, sky, to_rgb
from fgrecon.simulation.scenery import BODY_COLOURS, car_paint, planter, road, with_shadow
from fgrecon.simulation.vehicles import yaw_pose

CAMERA = Camera(np.array([[60.0, 0.0, 31.5], [0.0, 60.0, 23.5], [0.0, 0.0, 1.0]]), image_size=(64, 48))
SIZE = (64, 48)
PRIOR = load_prior("car14")
RED = (0.6, 0.0, 0.0)


def flat(colour):
    return lambda points, normals: (np.tile(np.asarray(colour, dtype=float), (len(points), 1)), np.zeros(len(normals)))


def square(depth, half=1.0):
    """A square that faces the camera, as a body."""
    corners = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]]) * half
    pose = np.eye(4)
    pose[2, 3] = depth
    return corners, np.array([[0, 2, 1], [0, 3, 2]]), pose


def nearest_hit(vertices, faces, ray):
    """Smallest z at which a ray (z = 1) from the origin meets a triangle, and the point's coordinates in it."""
    best = (np.inf, -1, None)
    for f, (a, b, c) in enumerate(vertices[faces]):
        system = np.stack([ray, a - b, a - c], axis=1)
        if abs(np.linalg.det(system)) < 1e-12:
            continue
        z, beta, gamma = np.linalg.solve(system, a)
        if beta >= 0 and gamma >= 0 and beta + gamma <= 1 and 0 < z < best[0]:
            best = (z, f, np.array([1 - beta - gamma, beta, gamma]))
    return best


def test_rasterise_finds_what_each_pixels_ray_meets():
    rng = np.random.default_rng(0)
    vertices = rng.uniform([-3, -2, 3], [3, 2, 9], (36, 3))
    faces = rng.permutation(36).reshape(12, 3)
    fragments = rasterise(vertices, faces, CAMERA.matrix, SIZE)
    found = np.full((48, 64), -1)
    found[fragments.rows, fragments.columns] = np.arange(len(fragments.rows))
    for row in range(0, 48, 3):
        for column in range(0, 64, 3):
            z, face, weights = nearest_hit(vertices, faces, CAMERA.rays([[column, row]])[0])
            m = found[row, column]
            assert (m >= 0) == (face >= 0)
            if face >= 0:
                assert fragments.face[m] == face
                assert fragments.depth[m] == pytest.approx(z, rel=1e-9)
                np.testing.assert_allclose(fragments.weights[m], weights, atol=1e-9)
    points = fragments.interpolate(vertices, faces)
    pixels = CAMERA.project(points)
    np.testing.assert_allclose(pixels, np.stack([fragments.columns, fragments.rows], axis=1), atol=1e-7)


def test_the_nearer_body_is_seen_in_any_order():
    near, far = square(4.0, 0.52), square(8.0, 2.0)
    bodies = [Body(*near[:2], flat([0.0, 1.0, 0.0]), near[2]), Body(*far[:2], flat([1.0, 0.0, 0.0]), far[2])]
    background = np.zeros((48, 64, 3))
    first = render(bodies, CAMERA, background)
    second = render(bodies[::-1], CAMERA, background)
    np.testing.assert_array_equal(first.image, second.image)
    np.testing.assert_array_equal(first.depth, second.depth)
    assert first.body[24, 32] == 0
    assert second.body[24, 32] == 1
    assert first.depth[24, 32] == pytest.approx(4.0)
    assert first.depth[24, 32 - 12] == pytest.approx(8.0)
    assert first.body[2, 2] == -1
    assert np.isinf(first.depth[2, 2])
    assert (first.body == 0).sum() == 16**2  # 31.5 +- 7.8: columns 24 to 39
    assert (first.body >= 0).sum() == 30**2  # 31.5 +- 15: columns 17 to 46


def test_edges_are_smooth_and_nothing_else_changes():
    near = square(4.0, 0.52)
    background = np.full((48, 64, 3), 0.2)
    picture = render([Body(*near[:2], flat([0.0, 0.0, 0.0]), near[2])], CAMERA, background, supersampling=5)
    outside = to_rgb(background[:1, :1])[0, 0]
    inside = picture.image[24, 32]
    assert (picture.image[:10] == outside).all()
    edge = picture.image[24, :, 0].astype(int)
    low, high = sorted((int(inside[0]), int(outside[0])))
    assert ((edge > low + 2) & (edge < high - 2)).sum() == 2


def test_bodies_off_the_image_or_behind_leave_the_background():
    background = np.random.default_rng(0).random((48, 64, 3))
    for move in ([50.0, 0.0, 5.0], [0.0, 0.0, -5.0]):
        corners, faces, pose = square(0.0)
        pose[:3, 3] = move
        picture = render([Body(corners, faces, flat(RED), pose)], CAMERA, background)
        np.testing.assert_array_equal(picture.image, to_rgb(background))
        assert (picture.body == -1).all()
    with pytest.raises(InvalidInputError, match="supersampling"):
        render([Body(corners, faces, flat(RED), pose)], CAMERA, background, supersampling=2)


def test_a_car_covers_its_own_box_and_shows_its_paint():
    camera = Camera(np.array([[300.0, 0.0, 159.5], [0.0, 300.0, 79.5], [0.0, 0.0, 1.0]]))
    pose = yaw_pose(2.4, np.array([0.0, 1.2, 8.0]))
    surface = PRIOR.surface
    names = PRIOR.category.keypoints
    body = Body(surface.mean, surface.faces, car_paint(PRIOR.mean, names, BODY_COLOURS["red"]), pose)
    picture = render([body], camera, np.zeros((160, 320, 3)))
    again = render([body], camera, np.zeros((160, 320, 3)))
    np.testing.assert_array_equal(picture.image, again.image)
    pixels = camera.project(surface.mean @ pose[:3, :3].T + pose[:3, 3])
    rows, columns = np.nonzero(picture.body >= 0)
    spanned = [columns.min(), rows.min(), columns.max(), rows.max()]
    np.testing.assert_allclose(spanned, [*pixels.min(axis=0), *pixels.max(axis=0)], atol=1.5)
    image = picture.image[picture.body >= 0].astype(int)
    red, green, blue = image.T
    assert ((red > green + 40) & (red > blue + 40)).mean() > 0.3  # the body
    assert (image.max(axis=1) < 110).mean() > 0.1  # windows and tyres
    assert (image.min(axis=1) > 170).mean() > 0.005  # a headlight, rims


def test_paint_knows_glass_tyres_and_lamps():
    names = PRIOR.category.keypoints
    at = dict(zip(names, PRIOR.mean, strict=True))
    paint = car_paint(PRIOR.mean, names, RED)

    def colour(point, normal):
        albedo, gloss = paint(np.array([point]), np.array([normal], dtype=float))
        assert gloss.shape == (1,)
        return albedo[0]

    roof = 0.5 * (at["left_front_roof"] + at["left_back_roof"]) * [1, 1, 0]
    np.testing.assert_allclose(colour(roof, [0, -1, 0]), RED)
    belt, top = at["left_side_mirror"][1], at["left_front_roof"][1]
    assert colour([at["left_front_roof"][0] - 0.4, 0.45 * belt + 0.55 * top, 0.7], [0, -0.3, 0.95]).max() < 0.05
    assert colour(at["left_headlight"], [1, 0, 0]).min() > 0.5
    lamp = colour(at["left_taillight"], [-1, 0, 0])
    assert lamp[0] > 0.5
    assert lamp[1] < 0.1
    assert colour(at["left_back_wheel"] + [0.8 * at["left_back_wheel"][1], 0, 0], [0, 0, 1]).max() < 0.05
    bare = car_paint(np.zeros((1, 3)), ("nose",), RED)  # another category: the body's colour alone
    np.testing.assert_allclose(bare(np.ones((2, 3)) * -1, np.ones((2, 3)))[0], [RED, RED])


def test_road_has_its_horizon_where_the_ground_ends():
    ground = Ground.level(1.65)
    camera = Camera(np.array([[300.0, 0.0, 159.5], [0.0, 300.0, 79.5], [0.0, 0.0, 1.0]]))
    picture = road(camera, ground, (320, 160), seed=1)
    assert picture.shape == (160, 320, 3)
    np.testing.assert_array_equal(picture, road(camera, ground, (320, 160), seed=1))
    assert np.abs(picture - road(camera, ground, (320, 160), seed=2)).max() > 0.05
    top, bottom = picture[:20].mean(axis=(0, 1)), picture[-20:].mean(axis=(0, 1))
    assert top[2] > 2 * bottom[2]
    tilted = road(camera, Ground(np.array([0.0, 1.0, 0.2]), 1.65), (320, 160), seed=1)
    # normal . ray = 0 at row 79.5 - 60: this road climbs, and covers rows where the level one has sky
    assert tilted[25:60].mean(axis=(0, 1))[2] < 0.8 * picture[25:60].mean(axis=(0, 1))[2]


def test_shadow_darkens_the_ground_below_only():
    camera = Camera(np.array([[300.0, 0.0, 159.5], [0.0, 300.0, 79.5], [0.0, 0.0, 1.0]]))
    pose = yaw_pose(0.3, np.array([0.0, 1.65, 9.0]))
    plain = np.ones((160, 320, 3))
    shaded = with_shadow(plain, camera, pose, 4.5, 1.8)
    assert (shaded[:79] == 1.0).all()
    below = np.round(camera.project(pose[:3, 3])).astype(int)
    assert shaded[below[1], below[0], 0] < 0.2
    assert shaded[-1, 0, 0] == 1.0
    assert (shaded >= 0.1).all()


def test_planter_is_a_closed_box_on_the_ground():
    vertices, faces, paint = planter(1.2, 0.4, 0.6, seed=0)
    a, b, c = vertices[faces].transpose(1, 0, 2)
    across = np.cross(b - a, c - a)
    volume = np.einsum("ij,ij->", a, across) / 6
    assert volume == pytest.approx(1.2 * 0.4 * 0.27 + 0.94 * 1.2 * 0.86 * 0.4 * 0.33, rel=1e-9)
    assert vertices[:, 1].max() == 0.0
    assert vertices[:, 1].min() == -0.6
    albedo, gloss = paint(vertices, across)
    assert albedo.shape == (48, 3)
    assert (gloss == 0).all()


def test_sky_and_colours():
    rays = pixel_rays(CAMERA.matrix, SIZE)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=-1), 1.0)
    up, down = sky(np.array([[0.0, -1.0, 0.0], [0.0, 1.0, 0.0]]))
    assert up[2] > up[0] > 0
    assert down.max() < 0.1
    grey = to_rgb(np.linspace(0, 20, 50)[:, None, None].repeat(3, axis=2))[:, 0, 0]
    assert grey.dtype == np.uint8
    assert (np.diff(grey.astype(int)) >= 0).all()
    assert grey[0] == 0
    assert grey[-1] == 255
