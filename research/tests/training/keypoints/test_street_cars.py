"""From labelled drives to views that are learnt from: the labels stay on the cars, masks on what is seen of them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.catalogue import load_prior
from fgrecon.io.coco_keypoints import write_coco_keypoints
from fgrecon.io.kitti_files import read_drive
from fgrecon.perception.keypoints.layout import KINDS
from fgrecon_research.annotation.annotate import annotate
from fgrecon_research.annotation.labels import silhouette, vehicle_labels
from fgrecon_research.training.keypoints.augment import Street
from fgrecon_research.training.keypoints.dataset import SIDE
from fgrecon_research.training.keypoints.street_cars import StreetCars, StreetShare, prepare_street_cars
from research.tests.annotation.streets import Car, GivenKeypoints, write_drive

PRIOR = load_prior("car14")
# A car ahead of another one, seen from behind, and a van at the image's border.
FRAMES = [
    {1: Car((0.0, 1.65, 20.0), -np.pi / 2), 2: Car((1.2, 1.65, 12.0), -np.pi / 2)},
    {1: Car((0.0, 1.65, 19.0), -np.pi / 2), 3: Car((-6.2, 1.65, 13.0), 0.6, kind="Van")},
]


@pytest.fixture(scope="module")
def annotations(tmp_path_factory):
    drive = write_drive(tmp_path_factory.mktemp("drives") / "street", PRIOR, FRAMES)
    made, _ = annotate(read_drive(drive), GivenKeypoints(FRAMES, PRIOR), PRIOR)
    assert len(made) == 4
    return made


@pytest.fixture(scope="module")
def cars(annotations, tmp_path_factory):
    folder = tmp_path_factory.mktemp("labels")
    labels = vehicle_labels([("street", one) for one in annotations], PRIOR.category, {})
    write_coco_keypoints(folder / "labels.json", labels)
    prepare_street_cars(folder / "labels.json", folder / "street")
    return StreetCars.load(folder / "street")


def area(polygons):
    """Of polygons, by the shoelace formula."""
    turned = [np.roll(p, -1, axis=0) for p in polygons]
    return sum(abs((p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum()) / 2.0 for p, q in zip(polygons, turned, strict=True))


def test_a_silhouette_is_what_the_surface_covers(annotations):
    """Oracle: the share of random pixels of the box that fall into the projection of some triangle."""
    alone = next(one for one in annotations if one.frame.number == 1 and one.track == 1)
    x1, y1, x2, y2 = alone.box
    corners = np.einsum("ij,fvj->fvi", alone.camera.matrix, alone.vertices[alone.faces])
    corners = corners[..., :2] / corners[..., 2:]
    points = np.random.default_rng(0).uniform([x1, y1], [x2, y2], (4000, 2))
    first, second, third = (corners[:, (i + 1) % 3] - corners[:, i] for i in range(3))
    sides = [
        edge[:, 0, None] * (points[:, 1] - corners[:, i, 1, None])
        - edge[:, 1, None] * (points[:, 0] - corners[:, i, 0, None])
        for i, edge in enumerate((first, second, third))
    ]
    inside = (np.all([side >= 0 for side in sides], axis=0) | np.all([side <= 0 for side in sides], axis=0)).any(axis=0)
    assert area(silhouette(alone)) == pytest.approx(inside.mean() * (x2 - x1) * (y2 - y1), rel=0.03)


def test_what_a_nearer_car_hides_is_not_in_the_silhouette(annotations):
    behind, before = (one for one in annotations if one.frame.number == 0)
    assert [behind.track, before.track] == [1, 2]
    whole = area(silhouette(next(o for o in annotations if o.frame.number == 1 and o.track == 1)))
    assert area(silhouette(behind)) < 0.75 * whole


def test_views_show_the_cars_with_their_labels(cars, annotations):
    assert len(cars.azimuth) == 4
    for index, one in enumerate(annotations):
        view = cars.view(index)
        assert view.image.shape == (SIDE, SIDE, 3)
        scale = (view.box[2] - view.box[0]) / (one.box[2] - one.box[0])
        assert scale == pytest.approx(SIDE / 1.5 / max(one.box[2:] - one.box[:2]), rel=1e-4)
        known = np.isfinite(view.keypoints[:, 0])
        back = (view.keypoints - view.box[:2]) / scale + one.box[:2]
        np.testing.assert_allclose(back[known], one.keypoints[known], atol=0.02)
        seen = known & (view.visible > 0.5)
        column, row = np.rint(view.keypoints[seen]).astype(int).T
        near = [view.mask[max(r - 6, 0) : r + 7, max(c - 6, 0) : c + 7].any() for c, r in zip(column, row, strict=True)]
        assert all(near)
        assert view.azimuth == pytest.approx(one.azimuth, abs=1e-4)
    assert sorted(set(cars.kinds.tolist())) == ["Car", "Van"]
    assert cars.drives.tolist() == ["street"] * 4
    assert cars.tracks.tolist() == [1, 2, 1, 3]


def test_of_lorries_direction_and_kind_are_learnt_and_no_keypoints(annotations, tmp_path):
    lorry = replace(annotations[0], kind="Truck")
    labels = vehicle_labels([("street", one) for one in (lorry, annotations[1])], PRIOR.category, {})
    write_coco_keypoints(tmp_path / "labels.json", labels)
    prepare_street_cars(tmp_path / "labels.json", tmp_path / "street")
    cars = StreetCars.load(tmp_path / "street")
    assert [KINDS[cars.view(i).kind] for i in (0, 1)] == ["lorry", "car"]
    assert np.isnan(cars.view(0).keypoints).all()
    assert np.isfinite(cars.view(1).keypoints).any()
    assert cars.view(0).azimuth == pytest.approx(lorry.azimuth, abs=1e-4)
    sample = cars.draw(np.array([0]), np.ones(1), Street().shaping(PRIOR), PRIOR.category.mirror, (0, 0))
    assert sample.kind == KINDS.index("lorry")
    assert not sample.visible.any()


def test_rear_views_are_drawn_more_often_than_fronts(cars):
    ahead = replace(cars, azimuth=np.array([0.1, 0.1, 3.0, 3.0]), tracks=np.arange(4), kinds=np.array(["Car"] * 4))
    front, _, rear, _ = ahead.weights(np.arange(4))
    assert rear == pytest.approx(1.3 * front)


def test_beyond_the_image_there_is_nothing_of_a_car(cars):
    (van,) = np.flatnonzero(cars.kinds == "Van")
    view = cars.view(int(van))
    border = int(np.ceil(view.box[0])) if view.box[0] > 0 else 0
    assert view.mask[:, : max(border - 2, 0)].max(initial=0) == 0


def test_files_that_hold_no_street_cars_are_refused(tmp_path):
    with pytest.raises(InvalidInputError, match="street"):
        StreetCars.load(tmp_path)
    (tmp_path / "no.json").write_text("{}")
    with pytest.raises(InvalidInputError, match="format"):
        prepare_street_cars(tmp_path / "no.json", tmp_path / "work")
    assert not (tmp_path / "work").exists()


def test_cars_that_are_there_are_all_there(annotations, tmp_path, monkeypatch):
    def killed(file, **arrays):
        with file if hasattr(file, "write") else Path(file).open("wb") as half:
            half.write(b"half of it")
        raise KeyboardInterrupt

    labels = vehicle_labels([("street", one) for one in annotations], PRIOR.category, {})
    write_coco_keypoints(tmp_path / "labels.json", labels)
    monkeypatch.setattr(np, "savez", killed)
    with pytest.raises(KeyboardInterrupt):
        prepare_street_cars(tmp_path / "labels.json", tmp_path / "street")
    assert not (tmp_path / "street" / "cars.npz").exists()


def test_only_drives_that_are_there_can_be_left_out(cars):
    assert len(StreetShare(cars, 0.5, ("street",)).chosen) == 0
    with pytest.raises(InvalidInputError, match=r"without: got steet.*among street\."):
        StreetShare(cars, 0.5, ("steet",))
