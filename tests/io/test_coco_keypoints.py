"""COCO keypoints: what is written reads back, another reader takes it, and what is malformed is named."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.catalogue import load_category
from fgrecon.io.coco_keypoints import (
    LabelledImage,
    VehicleLabel,
    VehicleLabels,
    read_coco_keypoints,
    write_coco_keypoints,
)
from fgrecon_research.io.annotations.named import read_coco

CATEGORY = load_category("car14")


def make_labels(folder, count=3, seed=0):
    """Made-up vehicles, two of them in one image; one has a keypoint outside and a corner behind the camera."""
    rng = np.random.default_rng(seed)
    matrix = np.array([[721.5, 0.0, 609.5], [0.0, 721.5, 172.9], [0.0, 0.0, 1.0]])
    images = [LabelledImage(folder / "drive" / f"{n:06d}.png", (1242, 375), matrix, "drive", n) for n in (4, 5)]
    vehicles = []
    for number in range(count):
        points = rng.uniform([0, 0], [1241, 374], (14, 2))
        corners = rng.uniform(0, 300, (8, 2))
        if number == 1:
            points[3], corners[6] = (-20.0, 50.0), np.nan
        spread = rng.uniform(0.5, 3.0, (14, 2))
        vehicles.append(
            VehicleLabel(
                image=images[min(number, 1)],
                track=10 + number,
                kind="Car",
                box=np.array([10.25, 20.5, 110.0, 80.0]) + number,
                keypoints=points,
                probability=rng.uniform(size=14),
                covariance=spread[:, None] * np.eye(2),
                corners=corners,
                location=rng.uniform([-5, 1, 8], [5, 2, 30]),
                rotation_y=float(rng.uniform(-3, 3)),
                size=np.array([4.0, 1.7, 1.5]),
                azimuth=float(rng.uniform(-3, 3)),
                agreement=0.75,
                boxed=False,
                vertices=rng.uniform([-5, 0, 8], [5, 2, 30], (5, 3)),
            )
        )
    faces = np.array([[0, 1, 2], [2, 3, 4]])
    return VehicleLabels("car14", CATEGORY.keypoints, CATEGORY.edges, tuple(vehicles), faces, {"by": "hand"})


@pytest.fixture
def labels(tmp_path):
    return make_labels(tmp_path)


def test_what_is_written_reads_back(labels, tmp_path):
    path = write_coco_keypoints(tmp_path / "labels.json", labels, meshes=True)
    found = read_coco_keypoints(path)
    assert (found.category, found.keypoints, found.skeleton) == ("car14", CATEGORY.keypoints, CATEGORY.edges)
    assert found.info == {"by": "hand"}
    assert found.faces.tolist() == labels.faces.tolist()
    assert len({id(vehicle.image) for vehicle in found.vehicles}) == 2
    for one, read in zip(labels.vehicles, found.vehicles, strict=True):
        assert (read.track, read.kind, read.agreement, read.boxed) == (one.track, one.kind, one.agreement, False)
        assert (read.image.path, read.image.size) == (one.image.path.resolve(), one.image.size)
        assert (read.image.drive, read.image.frame) == (one.image.drive, one.image.frame)
        np.testing.assert_array_equal(read.image.matrix, one.image.matrix)
        np.testing.assert_array_equal(read.flags, one.flags)
        expected = np.where(one.flags[:, None] > 0, one.keypoints, np.nan)
        np.testing.assert_allclose(read.keypoints, expected, atol=5e-3)
        np.testing.assert_allclose(read.vertices, one.vertices, atol=5.1e-4)
        for name in ("box", "probability", "covariance", "corners", "location", "rotation_y", "size", "azimuth"):
            np.testing.assert_allclose(getattr(read, name), getattr(one, name), rtol=5e-6, err_msg=name)
    again = write_coco_keypoints(tmp_path / "again.json", found, meshes=True)
    assert again.read_bytes() == path.read_bytes()


def test_the_fields_are_those_of_coco(labels, tmp_path):
    content = json.loads(write_coco_keypoints(tmp_path / "labels.json", labels).read_text())
    assert [image["file_name"] for image in content["images"]] == ["drive/000004.png", "drive/000005.png"]
    first, second, third = content["annotations"]
    assert [a["image_id"] for a in (first, second, third)] == [1, 2, 2]
    assert first["bbox"] == [10.25, 20.5, 99.75, 59.5]
    assert first["area"] == pytest.approx(99.75 * 59.5, rel=1e-5)
    assert first["iscrowd"] == 0
    assert first["num_keypoints"] == 14
    assert second["num_keypoints"] == 13
    assert second["keypoints"][9:12] == [0.0, 0.0, 0]
    assert second["cuboid"]["corners"][6] is None
    flags = np.array(first["keypoints"]).reshape(14, 3)[:, 2]
    np.testing.assert_array_equal(flags == 2, labels.vehicles[0].probability >= 0.5)
    assert min(min(pair) for pair in content["categories"][0]["skeleton"]) == 1
    assert "mesh" not in first
    assert "mesh_faces" not in content["categories"][0]
    assert read_coco_keypoints(tmp_path / "labels.json").faces is None


def test_the_area_is_that_of_the_polygons(labels, tmp_path):
    """As pycocotools counts the pixels in them; of the box where no part of the vehicle is seen."""
    mask = pytest.importorskip("pycocotools.mask")
    notched = np.array([[20.0, 30.0], [95.5, 28.0], [60.0, 50.0], [101.25, 77.0], [18.0, 70.0]])
    apart = np.array([[105.0, 40.0], [105.0, 70.0], [109.0, 70.0]])[::-1]
    seen = [(notched,), (notched, apart), ()]
    vehicles = tuple(replace(v, silhouette=s) for v, s in zip(labels.vehicles, seen, strict=True))
    path = write_coco_keypoints(tmp_path / "labels.json", replace(labels, vehicles=vehicles))
    annotations = json.loads(path.read_text())["annotations"]
    for one, polygons in zip(annotations[:2], seen, strict=False):
        expected = sum(cv2.contourArea(polygon.astype(np.float32)) for polygon in polygons)
        counted = mask.area(mask.merge(mask.frPyObjects(one["segmentation"], 375, 1242)))
        assert one["area"] == pytest.approx(expected, rel=1e-5)
        assert one["area"] == pytest.approx(counted, rel=0.03)
    assert annotations[2]["area"] == pytest.approx(99.75 * 59.5, rel=1e-5)
    again = write_coco_keypoints(tmp_path / "again.json", read_coco_keypoints(path))
    assert again.read_bytes() == path.read_bytes()


def test_terms_of_the_images_are_a_license_of_each(labels, tmp_path):
    assert json.loads(write_coco_keypoints(tmp_path / "labels.json", labels).read_text())["licenses"] == []
    licensed = replace(labels, terms="CC BY-NC-SA 3.0")
    path = write_coco_keypoints(tmp_path / "labels.json", licensed)
    content = json.loads(path.read_text())
    assert content["licenses"] == [{"id": 1, "name": "CC BY-NC-SA 3.0", "url": ""}]
    assert [image["license"] for image in content["images"]] == [1, 1]
    assert read_coco_keypoints(path).terms == licensed.terms


def test_flags_are_those_of_the_numbers_written(labels, tmp_path):
    first = labels.vehicles[0]
    first.keypoints[0], first.probability[1] = (1241.4999, 100.0), 0.49999999
    path = write_coco_keypoints(tmp_path / "labels.json", labels)
    written = np.array(json.loads(path.read_text())["annotations"][0]["keypoints"]).reshape(14, 3)
    assert written[0].tolist() == [0.0, 0.0, 0.0]  # 1241.5 is beyond the last pixel
    assert written[1, 2] == 2.0
    np.testing.assert_array_equal(read_coco_keypoints(path).vehicles[0].flags, written[:, 2])


def test_our_reader_of_other_peoples_coco_takes_it(labels, tmp_path):
    found = read_coco(write_coco_keypoints(tmp_path / "labels.json", labels), CATEGORY, {})
    assert len(found) == 3
    np.testing.assert_allclose(found.keypoints[0], labels.vehicles[0].keypoints, atol=5e-3)
    assert np.isnan(found.keypoints[1, 3]).all()


def test_images_elsewhere_are_named_relative_to_the_file(labels, tmp_path):
    (tmp_path / "out").mkdir()
    path = write_coco_keypoints(tmp_path / "out" / "labels.json", labels)
    assert json.loads(path.read_text())["images"][0]["file_name"] == "../drive/000004.png"
    assert read_coco_keypoints(path).vehicles[0].image.path == labels.vehicles[0].image.path.resolve()


def test_what_cannot_be_written_is_refused_and_the_file_stays(labels, tmp_path):
    (path := tmp_path / "labels.json").write_text("before")
    with pytest.raises(InvalidInputError, match="at least one"):
        write_coco_keypoints(path, replace(labels, vehicles=()))
    bare = replace(labels, vehicles=(replace(labels.vehicles[0], vertices=None),))
    for without in (bare, replace(labels, faces=None)):
        with pytest.raises(InvalidInputError, match="meshes"):
            write_coco_keypoints(path, without, meshes=True)
    spoilt = replace(labels, vehicles=(replace(labels.vehicles[0], azimuth=float("nan")),))
    with pytest.raises(ValueError, match="JSON compliant"):
        write_coco_keypoints(path, spoilt)
    assert path.read_text() == "before"


def test_links_to_one_file_of_a_store_are_images_of_their_own(labels, tmp_path):
    store, drive = tmp_path / "store", tmp_path / "drive"
    store.mkdir()
    drive.mkdir()
    (store / "3fa9c1").write_bytes(b"")
    for number in (4, 5):
        (drive / f"{number:06d}.png").symlink_to(store / "3fa9c1")
    (tmp_path / "elsewhere" / "deep").mkdir(parents=True)
    (tmp_path / "linked").symlink_to(tmp_path / "elsewhere" / "deep")  # whose `..` is another than it looks
    for folder, up in ((tmp_path, ""), (tmp_path / "linked", "../../")):
        path = write_coco_keypoints(folder / "labels.json", labels)
        document = json.loads(path.read_text())
        assert [image["file_name"] for image in document["images"]] == [f"{up}drive/{n:06d}.png" for n in (4, 5)]
        assert [one["image_id"] for one in document["annotations"]] == [1, 2, 2]
        assert all((folder / image["file_name"]).exists() for image in document["images"])
        again = write_coco_keypoints(folder / "again.json", read_coco_keypoints(path))
        assert json.loads(again.read_text())["images"] == document["images"]


def test_images_behind_a_link_move_with_it(labels, tmp_path):
    """The data folder is a link; file and link are moved together, and the link leads elsewhere then."""
    for disk in ("disk", "other"):
        (tmp_path / disk / "drive").mkdir(parents=True)
        for number in (4, 5):
            (tmp_path / disk / "drive" / f"{number:06d}.png").write_bytes(disk.encode())
    (project := tmp_path / "project").mkdir()
    (project / "data").symlink_to(tmp_path / "disk")
    linked = tuple(
        replace(v, image=replace(v.image, path=project / "data" / "drive" / v.image.path.name)) for v in labels.vehicles
    )
    (project / "made").mkdir()
    for folder, up in ((project, ""), (project / "made", "../"), (project / "made" / ".." / "made", "../")):
        path = write_coco_keypoints(folder / "labels.json", replace(labels, vehicles=linked))
        names = [image["file_name"] for image in json.loads(path.read_text())["images"]]
        assert names == [f"{up}data/drive/{n:06d}.png" for n in (4, 5)]
        found = read_coco_keypoints(path)
        assert found.vehicles[0].image.path == linked[0].image.path
        again = write_coco_keypoints(folder / "again.json", found)
        assert again.read_bytes() == write_coco_keypoints(path, found).read_bytes()
    moved = project.rename(tmp_path / "moved")
    (moved / "data").unlink()
    (moved / "data").symlink_to(tmp_path / "other")
    assert read_coco_keypoints(moved / "labels.json").vehicles[0].image.path.read_bytes() == b"other"


GONE = object()


@pytest.mark.parametrize(
    ("path", "value", "field"),
    [
        (["format"], "coco", "format"),
        (["categories"], [], "categories"),
        (["categories", 0, "keypoints"], [1], "categories[0].keypoints"),
        (["categories", 0, "skeleton", 0, 0], 0, "categories[0].skeleton"),
        (["categories", 0, "skeleton", 0, 0], 15, "categories[0].skeleton"),
        (["categories", 0, "mesh_faces", 1, 2], 5, "categories[0].mesh_faces"),
        (["categories", 0, "mesh_faces", 1, 2], 0.5, "categories[0].mesh_faces"),
        (["images", 1, "id"], GONE, "images[1].id"),
        (["images", 1, "width"], 0, "images[1].width, height"),
        (["images", 1, "camera_matrix", 2], None, "images[1].camera_matrix[2]"),
        (["licenses"], [{}], "licenses[0].name"),
        (["annotations", 2], 7, "annotations[2]"),
        (["annotations", 2, "image_id"], 9, "annotations[2].image_id"),
        (["annotations", 2, "bbox"], [1, 2, 3], "annotations[2].bbox"),
        (["annotations", 2, "keypoints", 5], 3, "annotations[2].keypoints"),
        (["annotations", 2, "keypoints"], [0] * 9, "annotations[2].keypoints"),
        (["annotations", 2, "keypoint_probability", 4], 1.5, "annotations[2].keypoint_probability"),
        (["annotations", 2, "keypoint_covariance", 4], [1], "annotations[2].keypoint_covariance[4]"),
        (["annotations", 2, "track_id"], GONE, "annotations[2].track_id"),
        (["annotations", 2, "kind"], 3, "annotations[2].kind"),
        (["annotations", 2, "cuboid"], None, "annotations[2].cuboid"),
        (["annotations", 2, "cuboid", "corners", 1], [1, "x"], "annotations[2].cuboid.corners[1][1]"),
        (["annotations", 2, "cuboid", "rotation_y"], "nan", "annotations[2].cuboid.rotation_y"),
        (["annotations", 2, "azimuth"], GONE, "annotations[2].azimuth"),
        (["annotations", 2, "mesh", 0], [1, 2], "annotations[2].mesh[0]"),
    ],
)
def test_a_malformed_file_names_file_and_field(labels, tmp_path, path, value, field):
    file = write_coco_keypoints(tmp_path / "labels.json", labels, meshes=True)
    content = json.loads(file.read_text())
    at = content
    for step in path[:-1]:
        at = at[step]
    if value is GONE:
        del at[path[-1]]
    else:
        at[path[-1]] = value
    file.write_text(json.dumps(content))
    with pytest.raises(InvalidInputError) as error:
        read_coco_keypoints(file)
    assert error.value.field == f"{file}: {field}"


def test_what_is_no_json_is_refused(tmp_path):
    (tmp_path / "labels.json").write_text("{")
    with pytest.raises(InvalidInputError, match=r"labels\.json"):
        read_coco_keypoints(tmp_path / "labels.json")
