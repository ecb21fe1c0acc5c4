"""Labels of annotation tools by their own libraries: what is exported they read, what they write is read."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from fgrecon.core.box3d import box_corners
from fgrecon.core.camera import Camera
from fgrecon.core.geometry import transform
from fgrecon.io.datasets import WorldBox
from fgrecon.io.export import ImageInfo, NamedResult, export
from fgrecon.io.export.image_info import image_box, keypoint_names, score
from fgrecon.io.keypoints import read_any_keypoints
from tests.io.formats import CATEGORY
from tests.io.test_tool_keypoints import BOX, NAMES, POINTS, THERE
from tests.results import changed
from tests.viz.made_up import make_example

from . import made_up

GIVEN = json.dumps({"box": BOX.tolist(), "points": {NAMES[i]: POINTS[i].tolist() for i in THERE}})
METRES, PIXELS = 1e-6, 1e-3
ROUNDED = {"datumaro": 0.0051, "cvat": 0.0101, "supervisely": 0.5001}
"""Pixels by which tools round, as the convention table says."""


@pytest.mark.formats
@pytest.mark.parametrize(
    ("tool", "off"),
    [("scalabel", 1e-9), ("openlabel", 1e-9), ("supervisely", 0.5001), ("datumaro", 0.0051)],  # two round
)
def test_what_a_tool_writes_is_read(tmp_path, devkit, tool, off):
    path = tmp_path / "labels.json"
    devkit(tool, f"{tool}_writes", tmp_path / "out" if tool == "datumaro" else path, given=GIVEN)
    if tool == "datumaro":
        (path,) = (tmp_path / "out").rglob("*.json")
    (vehicle,) = read_any_keypoints(path, CATEGORY).instances
    observation = vehicle.observation
    assert np.flatnonzero(observation.measured).tolist() == THERE
    assert np.abs(observation.keypoints[THERE] - POINTS[THERE]).max() < 2 * off
    assert np.abs(observation.box - BOX).max() < 2 * off
    assert vehicle.kind == ("carbox" if tool == "supervisely" else "car")


@pytest.fixture(scope="module")
def scene():
    """The made-up vehicles as results, by image: one cut off, headings through half a turn, some fields unknown."""
    made, found, time = make_example().reconstruction, {}, made_up.TIMES_NS[0]
    for camera in made_up.CAMERAS:
        lens = Camera(camera.matrix, image_size=(made_up.WIDTH, made_up.HEIGHT))
        camera_T_world = np.linalg.inv(made_up.world_T_vehicle(time) @ camera.vehicle_T_camera)
        items = found.setdefault(f"{camera.name}.png", [])
        for number, vehicle in enumerate(made_up.VEHICLES):
            size = np.array(vehicle.size)
            box = WorldBox(vehicle.name, "car", made_up.world_T_box(vehicle, time), size)
            pose = camera_T_world @ box.world_T_object
            if pose[2, 3] < 1.0:
                continue  # behind this camera
            lines = made.wireframe * (size / made.box_size)[[0, 2, 1]]
            values = {"camera_T_object": pose, "box_size": size, "wireframe": lines}
            values |= {"wireframe_uv": lens.project(transform(pose, lines)), "surface_vertices": None}
            given = {} if number == 0 else {"kind": ("Car", "Van")[number % 2], "score": 0.5 + 0.1 * number}
            outline = np.concatenate(
                [f(lens.project(transform(camera_T_world, box.corners)), 0) for f in (np.min, np.max)]
            )
            outline = np.clip(outline, 0.0, np.tile([made_up.WIDTH - 1.0, made_up.HEIGHT - 1.0], 2))
            result = changed(made, **values)
            items.append(NamedResult(vehicle.name, result, outline, image=f"{camera.name}.png", camera=lens, **given))
    return found


@pytest.fixture
def read(tmp_path, scene, devkit):
    """By image what a tool reads of its vehicles, and the files that it has written again."""
    named = ",".join(keypoint_names(scene["front.png"][0]))

    def of_tool(tool):
        again = tmp_path / "again.json"
        every = [item for items in scene.values() for item in items]
        if tool in ("labelme", "supervisely"):  # a file for each image
            found, files = {}, {}
            for image, items in scene.items():
                cv2.imwrite(str(tmp_path / image), np.zeros((made_up.HEIGHT, made_up.WIDTH, 3), np.uint8))
                path, files[image] = export(tmp_path / f"{image}.json", items, tool), tmp_path / f"again-{image}.json"
                more = ["Car,Van"] if tool == "supervisely" else []
                said = devkit(tool, f"{tool}_reads", path, files[image], *more, given=json.dumps(named.split(",")))
                found[image] = next(iter(said.values()))
            return found, files
        if tool in ("datumaro", "cvat"):
            folder = tmp_path / ("annotations" if tool == "datumaro" else "cvat/images")
            folder.mkdir(parents=True)
            for image in scene if tool == "cvat" else ():
                cv2.imwrite(str(folder / image), np.zeros((made_up.HEIGHT, made_up.WIDTH, 3), np.uint8))
            export(folder / "default.json" if tool == "datumaro" else folder.parent / "c.xml", every, tool)
            out = [] if tool == "cvat" else [tmp_path / "again"]  # whose skeletons it has taken apart
            said = devkit("datumaro", "datumaro_reads", folder.parent, tool, *out)
            files = [] if tool == "cvat" else list((tmp_path / "again").rglob("*.json"))
            return {f"{image}.png": some for image, some in said.items()}, dict.fromkeys(scene, *files) if files else {}
        path, info = tmp_path / "labels.json", {}
        if tool == "openlabel":
            places = {
                c.name: made_up.world_T_vehicle(made_up.TIMES_NS[0]) @ c.vehicle_T_camera for c in made_up.CAMERAS
            }
            info = {f"{name}.png": ImageInfo(world_T_camera=place) for name, place in places.items()}
        export(path, every, tool, info)
        more = [named, "Car,Van"] if tool == "label_studio" else []
        said = devkit(tool, f"{tool}_reads", path, again, *more)
        if tool == "openlabel":
            assert said["frames"] == [0, 1]
            for image, place in said["places"].items():
                assert np.abs(np.reshape(place, (4, 4)) - info[image].world_T_camera).max() < METRES
            said = {
                image: [one | {"world": info[image].world_T_camera.tolist()} for one in some]
                for image, some in said["images"].items()
            }
        return said, dict.fromkeys(scene, again)

    return of_tool


def _corners(item):
    return transform(item.result.camera_T_object, box_corners(item.result.box_size))


def _inside(item):
    pixels = item.result.pose.wireframe_uv
    return ((pixels >= 0.0) & (pixels <= [made_up.WIDTH - 1, made_up.HEIGHT - 1])).all(axis=1)


INSIDE = "supervisely", "label_studio"
"""Tools that have no keypoints outside the image."""
TOOLS = "openlabel", "scalabel", "labelme", "supervisely", "datumaro", "cvat", "fiftyone"


@pytest.mark.formats
@pytest.mark.parametrize("tool", TOOLS)
def test_a_tool_reads_the_scene_and_its_own_file_comes_back(scene, read, tool):
    said, files = read(tool)
    off = ROUNDED.get(tool, 1e-9) + 1e-9
    assert said.keys() == scene.keys()
    for image, items in scene.items():
        assert len(said[image]) == len(items)
        for item, one in zip(items, said[image], strict=True):
            assert one["kind"] == (item.kind or "Car")
            assert np.abs(np.array(one["box"]) - image_box(item)).max() < 2 * off
            points = np.array([one["points"].get(name, [np.nan] * 2) for name in keypoint_names(item)])
            assert np.nanmax(np.abs(points - item.result.pose.wireframe_uv)) < off
            inside = _inside(item) if tool == "supervisely" else True
            assert (np.isfinite(points[:, 0]) == inside).all()
            if tool not in ("supervisely", "cvat"):
                assert one["hidden"] == (item.result.diagnostics.visibility < 0.5).tolist()
            if tool in ("openlabel", "scalabel", "fiftyone"):
                assert one["score"] == pytest.approx(score(item))
            if "pixels" in one:
                assert np.abs(np.array(one["pixels"]) - item.camera.project(_corners(item))).max() < PIXELS
            if tool == "openlabel":
                ours = transform(np.array(one["world"]), _corners(item))
                assert np.abs(np.array(one["corners"]) - ours).max() < METRES
            if tool == "scalabel":
                theirs, ours = np.array(one["corners"])[:, None], _corners(item)
                assert np.linalg.norm(theirs - ours, axis=2).min(axis=0).max() < METRES
                assert (
                    np.abs(theirs[4:, 0].mean(axis=0) - ours[4:].mean(axis=0)).max() < METRES
                )  # its v1.. is the front
    assert ("pixels" in said["front.png"][0]) == (tool in ("datumaro", "fiftyone"))
    _check_back(scene, files, tool, off)


def _check_back(scene, files, tool, off):
    """What the tool has written again, read by us."""
    back = {}
    for image, path in files.items():
        for one in read_any_keypoints(path, CATEGORY).instances:
            back.setdefault(image if tool in ("labelme", "supervisely") else (one.image or image), []).append(one)
    for image in files:
        (found,) = [some for name, some in back.items() if name.startswith(image.removesuffix(".png"))]
        found = found[: len(scene[image])] if tool not in ("labelme", "supervisely") else found
        for item, one in zip(scene[image], found, strict=True):
            assert np.nanmax(np.abs(one.observation.keypoints - item.result.pose.wireframe_uv)) < 2 * off
            assert (one.observation.measured == (_inside(item) if tool in INSIDE else True)).all()
            assert np.abs(one.observation.box - image_box(item)).max() < 2 * off
            assert one.kind == (item.kind or "Car")


@pytest.mark.formats
def test_label_studios_converter_reads_the_scene(scene, read):
    said, files = read("label_studio")
    unit = np.array([made_up.WIDTH, made_up.HEIGHT]) / 100.0
    for image, items in scene.items():
        for item, one in zip(items, said[image]["box"], strict=True):
            low = np.array([one["x"], one["y"]]) * unit
            high = low + np.array([one["width"], one["height"]]) * unit
            assert np.abs(np.concatenate([low, high]) - image_box(item)).max() < 1e-9
            assert one["rectanglelabels"] == [item.kind or "Car"]
        points = [[one["x"], one["y"]] for one in said[image]["keypoint"]] * unit
        names = [one["keypointlabels"][0] for one in said[image]["keypoint"]]
        shown = [item.result.pose.wireframe_uv[_inside(item)] for item in items]
        assert np.abs(points - np.concatenate(shown)).max() < 1e-9
        assert names == [
            n for item in items for n, seen in zip(keypoint_names(item), _inside(item), strict=True) if seen
        ]
    _check_back(scene, files, "label_studio", 1e-9)


@pytest.mark.parametrize("tool", ["openlabel", "scalabel", "labelme", "supervisely", "datumaro", "fiftyone"])
def test_fields_that_nobody_knows_are_passed_over(tmp_path, scene, tool):
    path = export(tmp_path / "labels.json", scene["front.png"], tool)
    before = read_any_keypoints(path, CATEGORY).instances

    def filled(value):
        if isinstance(value, list):
            return [filled(item) for item in value]
        inside = {key: filled(item) for key, item in value.items()} if isinstance(value, dict) else value
        return {**inside, "x_unknown": {"a": [None]}} if isinstance(value, dict) and value.keys() & _OBJECTS else inside

    path.write_text(json.dumps(filled(json.loads(path.read_text()))))
    after = read_any_keypoints(path, CATEGORY).instances
    assert len(before) == len(after) == 4
    for one, other in zip(before, after, strict=True):
        assert np.array_equal(one.observation.keypoints, other.observation.keypoints, equal_nan=True)
        assert np.array_equal(one.observation.box, other.observation.box)


_OBJECTS = {
    "label",
    "box2d",
    "shape_type",
    "classTitle",
    "bbox",
    "bounding_box",
    "points",
    "category",
    "schema_version",
}


def test_a_fisheye_has_no_lens_in_scalabel(tmp_path, scene):
    item = scene["front.png"][0]
    lens = Camera(item.camera.matrix, [0.1, 0.0, 0.0, 0.0], item.camera.image_size, distortion_model="fisheye")
    (frame,) = json.loads(export(tmp_path / "s.json", [replace(item, camera=lens)], "scalabel").read_text())["frames"]
    assert frame["intrinsics"] is None
