"""Boxes of YOLO, KITTI's tracking set and nuScenes; what is malformed is one line."""

import contextlib
import json

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fgrecon.core.errors import FgreconError, InvalidInputError
from fgrecon.core.options import BoxModel
from fgrecon.io.boxes import boxes_in
from fgrecon.perception.boxes import GivenBoxes

from .formats import spoilt, write
from .test_cameras import nuscenes

PIXELS = np.zeros((100, 100, 3), np.uint8)
SIZE = 1000, 400
OBJECT = "Car 0 0 -1.57 10.0 20.0 30.0 40.0 1.5 1.6 4.0 1 2 20 1.5"


def read_boxes(file, image, *how, **more):
    """The cars alone."""
    return boxes_in(file, image, *how, **more).cars


def test_yolo(tmp_path):
    lines = "2 0.25 0.5 0.1 0.2 0.9\n0 0.5 0.5 0.1 0.1 0.9\n2 0.5 0.5 0.1 0.1 0.3\n2 0.75 0.5 0.1 0.2\n"
    found = read_boxes(write(tmp_path / "street.txt", lines), "street", SIZE)
    assert [(box.name, box.model) for box in found] == [("0", BoxModel.SURFACE), ("3", BoxModel.SURFACE)]
    assert found[0].corners == pytest.approx([200, 160, 300, 240])
    assert found[1].corners == pytest.approx([700, 160, 800, 240])
    write(tmp_path / "classes.txt", "car\nperson\n")
    (box,) = read_boxes(tmp_path / "street.txt", "street", SIZE)
    assert box.name == "1"
    write(tmp_path / "classes.txt", "person\n")
    with pytest.raises(InvalidInputError, match=r"classes\.txt: got person"):
        read_boxes(tmp_path / "street.txt", "street", SIZE)


@pytest.mark.parametrize("line", ["2 0.5 0.5 0.1 1.2", "2 0.5 0.5 0.1 x", "car 0.5 0.5 0.1 0.1", "2 nan 0.5 0.1 0.1"])
def test_malformed_yolo_names_the_line(tmp_path, line):
    path = write(tmp_path / "a.txt", f"2 0.5 0.5 0.1 0.1\n{line}\n")
    with pytest.raises(InvalidInputError, match=r"a\.txt:2: got "):
        read_boxes(path, "a", SIZE)


def test_yolo_needs_the_size_of_the_image(tmp_path):
    with pytest.raises(InvalidInputError, match="image's size"):
        read_boxes(write(tmp_path / "a.txt", "2 0.5 0.5 0.1 0.1"), "a")


def test_a_file_for_each_image(tmp_path):
    write(tmp_path / "a.txt", "2 0.5 0.5 0.1 0.1")
    write(tmp_path / "b.json", [{"image_id": "b", "category_id": 3, "bbox": [1, 2, 3, 4], "score": 0.9}])
    assert len(read_boxes(tmp_path, "a", SIZE)) == 1
    assert read_boxes(tmp_path, "b", SIZE)[0].corners.tolist() == [1, 2, 4, 6]
    assert boxes_in(tmp_path, "c", SIZE).left_out == "the folder has no file for it"
    with pytest.raises(InvalidInputError, match="has no file for it"):
        GivenBoxes(file=tmp_path).of_image(tmp_path / "c.png", PIXELS)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InvalidInputError, match=r"file .* for each image"):
        read_boxes(tmp_path / "empty", "a", SIZE)


def coco_of(*names, **more):
    """COCO's annotations with a car in each of some images, the first at x = 1, and so on."""
    return {
        "images": [{"id": number, "file_name": name} for number, name in enumerate(names, 1)],
        "categories": [{"id": 3, "name": "car"}],
        "annotations": [
            {"image_id": number, "category_id": 3, "bbox": [number, 2, 3, 4], **more}
            for number in range(1, len(names) + 1)
        ],
    }


def test_crowds_are_no_cars(tmp_path):
    assert read_boxes(write(tmp_path / "a.json", coco_of("a.jpg", iscrowd=1)), "a") == []
    assert len(read_boxes(write(tmp_path / "a.json", coco_of("a.jpg", iscrowd=0)), "a")) == 1


def test_images_of_one_name_are_distinguished_by_their_folders_or_refused(tmp_path):
    path = write(tmp_path / "boxes.json", coco_of("A/left/1.jpg", "B/left/1.jpg", "B/left/12.jpg"))
    for image, left in (("B/left/1", 2), ("/data/A/left/1", 1), ("12", 3)):
        (box,) = read_boxes(path, image)
        assert box.corners[0] == left
    (box,) = GivenBoxes(file=path).of_image(tmp_path / "B/left/1.jpg", PIXELS).cars
    assert box.corners[0] == 2
    for image in ("1", "left/1", "C/left/1"):
        with pytest.raises(InvalidInputError, match=r"got 1, which is A/left/1\.jpg and B/left/1\.jpg"):
            read_boxes(path, image)
    assert len(read_boxes(write(tmp_path / "boxes.json", coco_of("1.jpg", "1.jpg")), "1")) == 2, (
        "one image, listed twice"
    )


def test_names_of_images_that_look_like_numbers(tmp_path):
    path = write(
        tmp_path / "boxes.json", [{"image_id": name, "category_id": 3, "bbox": [1, 2, 3, 4]} for name in ("²", 4)]
    )
    assert len(read_boxes(path, "²")) == len(read_boxes(path, "000004")) == 1


def test_kittis_tracking_set(tmp_path):
    lines = [f"0 3 {OBJECT}", f"12 3 {OBJECT}", f"12 -1 {OBJECT.replace('Car', 'DontCare')}", f"12 4 {OBJECT} 0.9"]
    path = write(tmp_path / "0001.txt", "\n".join(lines))
    found = read_boxes(path, "000012")
    assert [(box.name, box.model) for box in found] == [("1", BoxModel.CUBOID), ("3", BoxModel.CUBOID)]
    assert found[0].corners.tolist() == [10, 20, 30, 40]
    assert read_boxes(path, "street") == []


def labelled(folder, **changes):
    """nuScenes' tables with a car 20 m ahead, a car behind and a truck."""

    def label(token, instance, x):
        centre = [413.0 + x, 1180.8, 0.75]
        place = {"translation": centre, "rotation": [1.0, 0.0, 0.0, 0.0], "size": [1.8, 4.0, 1.5]}
        return {"token": token, "sample_token": "f1", "instance_token": instance, **place}

    nuscenes(folder)
    images = json.loads((folder / "sample_data.json").read_text())
    images[0]["sample_token"] = "f1"
    tables = {
        "sample_data": images,
        "category": [{"token": "k1", "name": "vehicle.car"}, {"token": "k2", "name": "vehicle.truck"}],
        "instance": [{"token": "i1", "category_token": "k1"}, {"token": "i2", "category_token": "k2"}],
        "sample_annotation": [label("a1", "i1", 20.0), label("a2", "i1", -20.0), label("a3", "i2", 30.0)],
    }
    return nuscenes(folder, **{**tables, **changes})


def test_nuscenes(tmp_path):
    (box,) = read_boxes(labelled(tmp_path), "n015-2018__CAM_FRONT__15")
    assert (box.name, box.model) == ("a1", BoxModel.CUBOID)
    near = 20.0 - 2.0  # of the car's rear; f = 721.5 and 722.25, the camera 1.51 m above the ground
    width, height = box.corners[2:] - box.corners[:2]
    assert width == pytest.approx(721.5 * 1.8 / near, rel=0.03)
    assert box.corners[3] == pytest.approx(172.75 + 722.25 * 1.51 / near, abs=5)
    assert height == pytest.approx(722.25 * 1.5 / near, rel=0.1)


def test_nuscenes_lorries_are_taken_with_the_others(tmp_path):
    folder, image = labelled(tmp_path), "n015-2018__CAM_FRONT__15"
    assert boxes_in(folder, image).other_vehicles == {"truck": 1}
    car, lorry = boxes_in(folder, image, all_classes=True).cars
    assert [(one.kind, *one.vehicle_class.probabilities) for one in (car, lorry)] == [
        ("car", "vehicle.car"),
        ("truck", "vehicle.truck"),
    ]


@pytest.mark.parametrize(
    ("kind", "scheme", "name"), [("Truck", "kitti", "truck"), ("truck", "coco", "truck"), ("van", "fgrecon", "van")]
)
def test_a_word_is_a_class_by_the_scheme_that_has_it(tmp_path, kind, scheme, name):
    path = write(tmp_path / "a.csv", f"image,class,x1,y1,x2,y2\na,{kind},1,2,30,40\na,Pedestrian,1,2,30,40\n")
    assert boxes_in(path, "a").classes == {kind: 1, "Pedestrian": 1}
    found = boxes_in(path, "a", all_classes=True)
    assert [(one.vehicle_class.scheme, *one.vehicle_class.probabilities) for one in found.cars] == [(scheme, name)]
    assert found.classes == {"Pedestrian": 1}


def test_a_car_that_reaches_the_near_plane_has_no_box_and_is_counted(tmp_path):
    folder = labelled(tmp_path)
    labels = json.loads((folder / "sample_annotation.json").read_text())
    beside = {**labels[0], "token": "a4", "translation": [414.5, 1183.0, 0.75]}  # from 0.5 m behind to 3.5 m ahead
    found = boxes_in(labelled(tmp_path, sample_annotation=[labels[1], beside]), "n015-2018__CAM_FRONT__15")
    assert (found.cars, found.near) == ([], 1)  # what is behind the camera is in no image
    assert found.left_out == "left out: 1 nearer to the camera than 0.5 m, which have no 2D box"


def test_nuscenes_as_its_own_library_projects_it(tmp_path):
    pytest.importorskip("nuscenes.utils.data_classes", exc_type=ImportError)
    from nuscenes.utils.data_classes import Box
    from nuscenes.utils.geometry_utils import view_points
    from pyquaternion import Quaternion

    folder = labelled(tmp_path)
    label, sensor, pose = (
        json.loads((folder / f"{name}.json").read_text())[0]
        for name in ("sample_annotation", "calibrated_sensor", "ego_pose")
    )
    box = Box(label["translation"], label["size"], Quaternion(label["rotation"]))
    for frame in (pose, sensor):
        box.translate(-np.array(frame["translation"]))
        box.rotate(Quaternion(frame["rotation"]).inverse)
    pixels = view_points(box.corners(), np.array(sensor["camera_intrinsic"]), normalize=True)[:2]
    (found,) = read_boxes(folder, "n015-2018__CAM_FRONT__15")
    assert found.corners == pytest.approx([*pixels.min(1), *pixels.max(1)], abs=1e-6)


COCO = {
    "images": [{"id": 1, "file_name": "a.jpg"}],
    "categories": [{"id": 3, "name": "car"}],
    "annotations": [{"image_id": 1, "category_id": 3, "bbox": [1, 2, 3, 4], "score": 0.9}],
}
FUZZ = settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.too_slow])


@FUZZ
@given(spoilt(COCO) | spoilt(COCO["annotations"]))
def test_no_coco_ends_in_another_exception(tmp_path_factory, content):
    with contextlib.suppress(FgreconError):
        read_boxes(write(tmp_path_factory.getbasetemp() / "boxes.json", json.dumps(content)), "a", SIZE)


@FUZZ
@given(st.lists(st.sampled_from(["2", "0.5", "-1", "car", "Car", "12", "x", "1e400", "nan", "00"]), max_size=19))
def test_no_line_ends_in_another_exception(tmp_path_factory, words):
    with contextlib.suppress(FgreconError):
        read_boxes(write(tmp_path_factory.getbasetemp() / "boxes.txt", " ".join(words)), "12", SIZE)


def test_yolo_of_a_tracker(tmp_path):
    """The id stands last, with a score before it or without."""
    lines = "2 0.25 0.5 0.1 0.2 0.9 7\n2 0.5 0.5 0.1 0.1 12\n2 0.5 0.5 0.1 0.1 0\n2 0.75 0.5 0.1 0.2 0.3 4\n"
    found = read_boxes(write(tmp_path / "street.txt", lines), "street", SIZE)
    assert [(box.name, box.score, box.track) for box in found] == [("0", 0.9, 7), ("1", None, 12), ("2", None, 0)]
    assert found[0].corners == pytest.approx([200, 160, 300, 240])


@pytest.mark.parametrize(
    "line", ["2 0.5 0.5 0.1 0.1 0.9 0.2", "2 0.5 0.5 0.1 0.1 1.5 3", "1,7,10,20,30,40,0.9,-1,-1,-1"]
)
def test_what_is_no_line_of_a_tracker_names_the_line(tmp_path, line):
    path = write(tmp_path / "a.txt", f"2 0.5 0.5 0.1 0.1 0.9 3\n{line}\n")
    with pytest.raises(InvalidInputError, match=r"a\.txt:2: got "):
        read_boxes(path, "a", SIZE)


@pytest.mark.parametrize("kind", ["car", "Car", "CAR"])
def test_names_of_classes_without_regard_to_capitals(tmp_path, kind):
    label = write(tmp_path / "a.txt", OBJECT.replace("Car", kind))
    assert [box.kind for box in read_boxes(label, "a")] == [kind]
    line = write(tmp_path / "d.txt", f"a.png {kind} 0.9 1 2 3 4")
    assert [box.kind for box in read_boxes(line, "a")] == ["Car"]
    content = coco_of("a.jpg") | {"categories": [{"id": "3.0", "name": kind}]}
    assert [box.kind for box in read_boxes(write(tmp_path / "c.json", content), "a")] == [kind]


@pytest.mark.parametrize("number", [1, 1.0, "1"])
def test_ids_are_alike_whatever_way_they_are_written(tmp_path, number):
    content = coco_of("a.jpg") | {"images": [{"id": number, "file_name": "a"}]}
    assert len(read_boxes(write(tmp_path / "c.json", content), "a")) == 1
    results = [{"image_id": name, "category_id": 3.0, "bbox": [1, 2, 3, 4]} for name in ("a.png", "b.png", 1)]
    path = write(tmp_path / "r.json", results)
    assert len(read_boxes(path, "a")) == len(read_boxes(path, "b")) == len(read_boxes(path, "000001")) == 1


def test_where_there_is_no_car_it_is_said_what_there_is(tmp_path):
    entries = [
        {"image_id": 0, "category_id": 2, "bbox": [1, 2, 3, 4]},
        {"image_id": 0, "category_id": 3, "bbox": [1, 2, 3, 4], "score": 0.2},
        *({"image_id": number, "category_id": 3, "bbox": [1, 2, 3, 4]} for number in (4, 5)),
    ]
    path = write(tmp_path / "r.json", entries)
    with pytest.raises(InvalidInputError) as caught:
        GivenBoxes(file=path).of_image(tmp_path / "000000.png", PIXELS)
    for part in ("1 with a score below", "1 of other classes (bicycle)", "2 of other images (4, 5)"):
        assert part in caught.value.fix


def test_other_vehicles_are_counted(tmp_path):
    lines = [OBJECT.replace("Car", kind) for kind in ("Car", "Van", "Van", "Truck", "Pedestrian")]
    found = boxes_in(write(tmp_path / "a.txt", "\n".join(lines)), "a")
    assert dict(found.other_vehicles) == {"Van": 2, "Truck": 1}
    assert len(found.cars) == 1


def test_class_score_and_track_of_coco(tmp_path):
    path = write(tmp_path / "c.json", coco_of("a.jpg", score=0.75, track_id=7))
    assert [(box.kind, box.score, box.track) for box in read_boxes(path, "a")] == [("car", 0.75, 7)]


def test_boxes_of_a_resized_picture_are_refused_or_scaled(tmp_path):
    def stated(width, height):
        content = coco_of("a.jpg")
        content["images"][0] |= {"width": width, "height": height}
        return write(tmp_path / "c.json", content)

    assert read_boxes(stated(1000, 400), "a", SIZE)[0].corners.tolist() == [1, 2, 4, 6]
    for width, height in ((500, 200), (640, 640)):
        with pytest.raises(InvalidInputError, match=f"{width} x {height} pixels.*1000 x 400"):
            read_boxes(stated(width, height), "a", SIZE)
    assert read_boxes(stated(500, 200), "a", SIZE, scale_to_image=True)[0].corners.tolist() == [2, 4, 8, 12]
    with pytest.raises(InvalidInputError, match="640 x 640"):
        read_boxes(stated(640, 640), "a", SIZE, scale_to_image=True)


CSV_HEADINGS = {
    "image,class,score,x1,y1,x2,y2,track": "a.png,car,0.75,10,20,110,70,7",
    "x_min,y_min,x_max,y_max,class_id,confidence,tracker_id,file_name": "10,20,110,70,2,0.75,7,folder/a.png",
    "filename,width,height,class,xmin,ymin,xmax,ymax,confidence,track_id": "a.png,1000,400,Car,10,20,110,70,0.75,7",
    "Image, Label, Conf, X, Y, W, H, Track ID": "a,car,0.75,10,20,100,50,7.0",
    "xmin,ymin,xmax,ymax,confidence,class,name,track": "10.0,20.0,110.0,70.0,0.75,2,car,7",
}


@pytest.mark.parametrize("heading", CSV_HEADINGS)
def test_boxes_of_csv_files(tmp_path, heading):
    path = write(tmp_path / "boxes.csv", f"{heading}\n{CSV_HEADINGS[heading]}\n\n")
    (box,) = read_boxes(path, "a", SIZE)
    assert box.corners.tolist() == [10, 20, 110, 70]
    assert (box.kind.lower(), box.score, box.track, box.model) == ("car", 0.75, 7, BoxModel.SURFACE)
    assert bool(read_boxes(path, "b", SIZE)) == ("name" in heading and "file" not in heading), "of any image"


def test_what_is_wrong_with_a_csv_file(tmp_path):
    with pytest.raises(InvalidInputError, match=r"b\.csv:1: got image,u,v"):
        read_boxes(write(tmp_path / "b.csv", "image,u,v\na,1,2\n"), "a", SIZE)
    for row in ("a,1,2,3", "a,1,2,x,4", "a,5,2,3,4", "a,1,2,nan,4"):
        with pytest.raises(InvalidInputError, match=r"b\.csv:3: got a,"):
            read_boxes(write(tmp_path / "b.csv", f"image,x1,y1,x2,y2\na,1,2,3,4\n{row}\n"), "a", SIZE)
    stated = write(tmp_path / "b.csv", "filename,width,height,class,xmin,ymin,xmax,ymax\na,500,200,car,1,2,3,4\n")
    with pytest.raises(InvalidInputError, match="500 x 200"):
        read_boxes(stated, "a", SIZE)
    assert read_boxes(stated, "a", SIZE, scale_to_image=True)[0].corners.tolist() == [2, 4, 6, 8]


@pytest.mark.parametrize("names", ["[person, car]", "{0: person, 1: Car}", "\n  0: person\n  1: car"])
def test_classes_of_a_data_set_of_yolos(tmp_path, names):
    (tmp_path / "train/labels").mkdir(parents=True)
    write(tmp_path / "data.yaml", f"path: .\nnames: {names}\n")
    write(tmp_path / "train/labels/a.txt", "1 0.5 0.5 0.1 0.1 0.75 3\n0 0.5 0.5 0.1 0.1\n")
    found = boxes_in(tmp_path / "train/labels", "a", SIZE)
    assert [(box.kind.lower(), box.score, box.track) for box in found.cars] == [("car", 0.75, 3)]
    assert found.reasons == {"of other classes (person)": 1}


def test_boxes_of_one_image_are_not_those_of_several(tmp_path):
    path = write(tmp_path / "a.txt", "2 0.5 0.5 0.1 0.1")
    GivenBoxes(file=path).check_images(1)
    GivenBoxes(file=tmp_path).check_images(2)
    GivenBoxes(file=write(tmp_path / "d.txt", "a.png car 0.9 1 2 3 4")).check_images(2)
    with pytest.raises(InvalidInputError, match="of one image, for 2 images"):
        GivenBoxes(file=path).check_images(2)
