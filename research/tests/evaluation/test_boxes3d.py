"""3D boxes of several sources against labels: matched, measured, and averaged as worked out by hand."""

import json
from dataclasses import replace

import numpy as np
import pytest

from fgrecon.calibration.labelled_boxes import wanted
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.kitti_files import format_results, read_drive, read_images
from fgrecon_research.evaluation.boxes3d import read_boxes, read_boxes_of_drives, score
from fgrecon_research.evaluation.boxes_summary import document, precisions, precisions_of_drives, summarise
from fgrecon_research.io.kitti_sets import parse_objects, write_results
from tests.command_line import run


@pytest.fixture
def drive(data):
    """A drive of labelled frames; `moved` writes results that are its labels, changed."""
    return read_drive(data / "kitti_video" / "kitti_tracking_0001")


def precisions_of(drive, results, numbers):
    return precisions_of_drives([drive], {drive.name: results}, {drive.name: numbers})


def frames_of(drive, count=3):
    return [frame for frame in drive.frames if len(wanted(frame)) > 2][:count]


def write_moved(folder, frames, change):
    """Results that are the labels, changed by a function of the objects; `DontCare` is no result."""
    results = {}
    for frame in frames:
        labels = frame.objects.take(np.array([kind in ("Car", "Van") for kind in frame.objects.kind]))
        results[f"{frame.number:06d}"] = change(replace(labels, score=np.full(len(labels), 0.9)))
    write_results(folder, results)
    return folder


def shifted(objects, metres=0.0, turn=0.0, longer=0.0):
    location, size = objects.location.copy(), objects.size.copy()
    location[:, 2] += metres
    size[:, 0] += longer
    kinds = tuple("Car" for _ in objects.kind)
    return replace(objects, kind=kinds, location=location, rotation_y=objects.rotation_y + turn, size=size)


@pytest.mark.data
def test_labels_as_results_are_perfect(drive, tmp_path):
    frames = frames_of(drive, 15)
    numbers = [frame.number for frame in frames]
    boxes = read_boxes(write_moved(tmp_path, frames, shifted), numbers)
    vehicles = score(drive, boxes, numbers)
    assert len(vehicles) == sum(len(wanted(frame)) for frame in frames)
    assert all(
        one.found and one.overlap == pytest.approx(1.0, abs=0.02) for one in vehicles
    )  # two decimals are written
    whole = summarise(vehicles)["cars"]
    assert [share.value for share in (*whole.right, *whole.ground, *whole.within)] == [100.0] * 7
    assert (whole.flipped, whole.mean_metres.value) == (0.0, pytest.approx(0.0, abs=1e-3))
    hard = precisions_of(drive, boxes, numbers)[2]
    assert (hard.image, hard.orientation, hard.volume[1]) == pytest.approx((100.0, 100.0, 100.0))
    assert hard.labels > 41


@pytest.mark.data
def test_errors_are_those_that_were_made(drive, tmp_path):
    frames = frames_of(drive)
    numbers = [frame.number for frame in frames]
    folder = write_moved(tmp_path, frames, lambda labels: shifted(labels, metres=1.0, turn=np.pi, longer=0.2))
    vehicles = score(drive, read_boxes(folder, numbers), numbers)
    groups = summarise(vehicles)
    cars = groups["cars"]
    assert cars.mean_metres.value == pytest.approx(1.0, abs=1e-3)
    assert (cars.flipped, cars.within[2].value) == (100.0, 0.0)
    np.testing.assert_allclose(cars.size, [0.2, 0.0, 0.0], atol=1e-3)
    assert cars.intervals["absolute_size"].value == pytest.approx(0.2 / 3.0, abs=1e-3)
    assert cars.intervals["median_metres"].value == cars.median_metres == pytest.approx(1.0, abs=1e-3)
    assert cars.depth > 0.0
    assert all(0.0 < one.overlap <= one.footprint < 0.9 for one in vehicles)
    assert all(above.value >= volume.value for above, volume in zip(cars.ground, cars.right, strict=True))
    assert sum(groups[name].vehicles for name in groups if name.startswith("cars ")) == cars.vehicles


@pytest.mark.data
def test_what_is_not_found_counts(drive, tmp_path):
    frames = frames_of(drive)
    numbers = [frame.number for frame in frames]
    boxes = read_boxes(write_moved(tmp_path, frames, lambda labels: shifted(labels.take(np.array([0])))), numbers)
    cars = summarise(score(drive, boxes, numbers))["cars"]
    assert 0 < cars.found < cars.vehicles
    assert cars.right[0].value == pytest.approx(100.0 * cars.found / cars.vehicles)
    nothing = score(drive, boxes, numbers, min_score=0.95)
    assert not any(one.found for one in nothing)
    report = document({"none": nothing}, {"none": precisions_of(drive, boxes, numbers)})
    plain = json.loads(json.dumps(report, allow_nan=False))["sources"][0]["groups"]["cars"]
    assert (plain["mean_metres"], plain["median_metres"], plain["intervals"]) == (None, None, {})


@pytest.mark.data
def test_a_file_of_tracking_lines_is_a_source(drive, tmp_path):
    frames = frames_of(drive)
    numbers = [frame.number for frame in frames]
    folder = write_moved(tmp_path / "boxes", frames, shifted)
    lines = []
    for frame in frames:
        text = (folder / f"{frame.number:06d}.txt").read_text()
        lines += [f"{frame.number} {i} {line}" for i, line in enumerate(text.splitlines())]
    (tmp_path / "track.txt").write_text("\n".join(lines) + "\n")
    assert score(drive, read_boxes(tmp_path / "track.txt", numbers), numbers) == score(
        drive, read_boxes(folder, numbers), numbers
    )


def test_the_folder_of_a_run_is_a_source_of_its_frames(tmp_path):
    """Those without a vehicle are spoken of as well, others are not."""
    (tmp_path / "tracks.txt").write_text("3 7 Car 0 0 0 10 20 30 40 1.5 1.6 4.0 1 2 20 1.5 0.9\n")
    (tmp_path / "frames.jsonl").write_text("".join(json.dumps({"frame": number}) + "\n" for number in (3, 4, 5)))
    assert {number: len(found) for number, found in read_boxes(tmp_path, [2, 3, 4]).items()} == {3: 1, 4: 0}
    (tmp_path / "frames.jsonl").write_text("[]\n")
    with pytest.raises(InvalidInputError, match=r"frames\.jsonl"):
        read_boxes(tmp_path, [3])


@pytest.mark.parametrize(
    ("text", "match"), [("0 1 Car x", "malformed"), ("0 Car", "track"), ("a b Car 1", "track")], ids=str
)
def test_malformed_lines_are_named(tmp_path, text, match):
    (tmp_path / "track.txt").write_text(text)
    with pytest.raises(InvalidInputError, match=match):
        read_boxes(tmp_path / "track.txt", [0])
    with pytest.raises(InvalidInputError, match="results"):
        read_boxes(tmp_path, [0])


@pytest.mark.data
def test_a_box_of_a_vehicle_that_does_not_count_is_no_others(drive):
    """A hidden van, and in the image over it a car that counts; the source finds the van alone."""
    frame = frames_of(drive)[0]
    row = int(wanted(frame)[0])
    one = frame.objects.take(np.array([row]))
    labels = one.take(np.array([0, 0]))
    corners = labels.box.copy()
    corners[1, [0, 2]] += 0.1 * (corners[1, 2] - corners[1, 0])
    labels = replace(labels, kind=("Car", "Van"), box=corners, occlusion=np.array([0, 3]))
    made = replace(frame, objects=labels, tracks=np.array([4, 5]), usable=np.array([True, True]))
    found = replace(labels.take(np.array([1])), kind=("Car",), score=np.ones(1))
    (car,) = score(replace(drive, frames=(made,)), {frame.number: found}, [frame.number])
    assert not car.found
    own = replace(found, box=corners[:1])
    assert score(replace(drive, frames=(made,)), {frame.number: own}, [frame.number])[0].found


@pytest.mark.data
def test_a_detectors_vans_are_vehicles_too(drive, tmp_path):
    frames = frames_of(drive)
    numbers = [frame.number for frame in frames]
    folder = write_moved(tmp_path, frames, lambda labels: replace(shifted(labels), kind=("Van",) * len(labels)))
    assert all(one.found for one in score(drive, read_boxes(folder, numbers), numbers))


@pytest.mark.data
def test_what_is_drawn_over_may_be_missed(drive):
    """Only what counts is found, and precision and recall are whole nevertheless."""
    numbers = [frame.number for frame in drive.frames if frame.labelled]
    results = {}
    for frame in drive.frames:
        usable = frame.objects.take(np.flatnonzero(frame.usable & np.isin(frame.objects.kind, ("Car", "Van"))))
        results[frame.number] = replace(shifted(usable), score=np.full(len(usable), 0.9))
    assert not all(frame.usable.all() for frame in drive.frames)
    _, *found = precisions_of(drive, results, numbers)
    assert [one.image for one in found] == pytest.approx([100.0] * 2)
    clean = [replace(frame, usable=np.ones(len(frame.objects), dtype=bool)) for frame in drive.frames]
    assert precisions_of(replace(drive, frames=tuple(clean)), results, numbers)[1].image < 95.0


@pytest.mark.parametrize(("count", "image"), [(40, None), (41, 100.0)])
def test_of_few_labels_there_is_no_average_precision(count, image):
    """At most one point of the curve's 41 is each label's: of 40, perfect boxes come to 97.5 %."""
    line = "Car 0 0 0 100 100 200 200 1.5 1.6 4.0 0 1.6 15 0 1\n"
    cars = parse_objects(line, "a line", scored=True)[0]
    found = {str(number): cars for number in range(count)}
    for regime in precisions(found, found):
        assert regime.labels == count
        assert regime.image == regime.orientation == image
        assert regime.ground == regime.volume == (image, image)


@pytest.mark.data
def test_intervals_are_over_tracks_of_a_drive_and_over_single_images(drive, data):
    frames = frames_of(drive)
    results = {frame.number: replace(shifted(frame.objects), score=np.ones(len(frame.objects))) for frame in frames}
    groups = {one.group for one in score(drive, results, [*results])}
    assert groups == {str(frame.tracks[row]) for frame in frames for row in wanted(frame)}
    single = read_images(data / "kitti_object" / "training")
    nothing = {frame.number: frame.objects.take(np.zeros(0, dtype=int)) for frame in single.frames}
    empty = {number: replace(objects, score=np.zeros(0)) for number, objects in nothing.items()}
    assert all(one.group == one.frame for one in score(single, empty, [*empty]))


@pytest.mark.data
def test_the_command_sets_sources_side_by_side(data, drive, tmp_path):
    frames = frames_of(drive, 5)
    good = write_moved(tmp_path / "good", frames, shifted)
    poor = write_moved(tmp_path / "poor", frames[1:], lambda labels: shifted(labels, metres=3.0))
    done = run("evaluate", "boxes", data / "kitti_video" / "kitti_tracking_0001", f"best={good}", poor, "--json", "-")
    assert done.exit_code == 0, done.output
    sources = json.loads(done.stdout)["sources"]
    assert [one["name"] for one in sources] == ["best", "poor"]
    right = [one["groups"]["cars"]["right"][0]["value"] for one in sources]
    assert right[0] == 100.0 > right[1]
    assert len({len(one["vehicles"]) for one in sources}) == 1  # the frames that both speak of
    again = run("evaluate", "boxes", data / "kitti_video" / "kitti_tracking_0001", good, good)
    assert "another name" in str(again.exception)


@pytest.fixture
def two_drives(tmp_path):
    """Two drives of two images, one car in each, whose track has the same number in both; images are not opened."""
    folders = [tmp_path / "labels" / name for name in ("one", "two")]
    for folder in folders:
        (folder / "image_02").mkdir(parents=True)
        for number in (3, 4):
            (folder / "image_02" / f"{number:06d}.png").touch()
        (folder / "label_02.txt").write_text("".join(f"{number} 7 {CAR}\n" for number in (3, 4)))
        (folder / "calib.txt").write_text("P2: 700 0 80 40 0 700 50 0.2 0 0 1 0.002\n")
    return folders


CAR = "Car 0 0 1.5 100 100 200 200 1.5 1.6 4.0 0.1 1.6 15 1.5"


def test_drives_are_scored_together(two_drives, tmp_path):
    """A folder or a file by the drive's name; intervals draw tracks of both; what only one source has is left out."""
    boxes, other = tmp_path / "boxes", tmp_path / "other"
    for place in (boxes / "one", other / "one"):
        place.mkdir(parents=True)
    far = CAR.replace(" 15 ", " 18 ")
    (boxes / "one" / "000003.txt").write_text(f"{CAR}\n")
    (boxes / "one" / "000004.txt").write_text("")
    (boxes / "two.txt").write_text(f"3 1 {far}\n4 1 {far}\n")
    (other / "one" / "000003.txt").write_text(f"{far} 0.5\n")
    made, table = tmp_path / "r.json", tmp_path / "r.md"
    done = run("evaluate", "boxes", *two_drives, boxes, "--json", made, "--markdown", table, "--verbose")
    assert done.exit_code == 0, done.output
    assert "2 drives, 4 images." in done.stdout
    assert "boxes two/000004/0 Car: 3.00 m" in done.stdout
    (source,) = json.loads(made.read_text())["sources"]
    assert [(one["drive"], one["frame"], one["found"]) for one in source["vehicles"]] == [
        *(("one", "000003", True), ("one", "000004", False)),
        *(("two", "000003", True), ("two", "000004", True)),
    ]
    cars = source["groups"]["cars"]
    assert (cars["tracks"], cars["found"], cars["right"][0]) == (2, 3, {"value": 25.0, "low": 0.0, "high": 50.0})
    assert source["average_precision_40"][0]["volume"] == [None, None]
    rows = [line.split(" | ") for line in table.read_text().splitlines()]
    assert rows[2][:5] == ["| cars", "boxes", "4", "3", "25 (0-50)"]
    assert rows[-1][3:] == ["-"] * 5 + ["- |"]
    alone = run("evaluate", "boxes", *two_drives, boxes, other)
    assert "1 drive, 1 image." in alone.stdout
    assert "of them: two." in alone.stdout
    (drive,) = (read_drive(folder) for folder in two_drives[:1])
    found = read_boxes_of_drives(boxes, [drive])
    assert score(drive, found["one"], [3, 4]) == score(drive, read_boxes(boxes / "one", [3, 4]), [3, 4])


def test_drives_and_boxes_that_cannot_be_scored_together(two_drives, tmp_path):
    for given, field in (
        ((*two_drives, *two_drives[:1], tmp_path), "drives"),
        (two_drives, "results"),
        ((*two_drives, tmp_path), "results"),
        ((two_drives[0], tmp_path / "none"), "results"),
    ):
        refused = run("evaluate", "boxes", *given).exception
        assert isinstance(refused, InvalidInputError)
        assert refused.field == field


@pytest.mark.data
def test_a_published_detectors_boxes(data):
    """DD3D on a drive, of which `data` says: median position error 2.7 %, yaw 1.7 degrees, 3.4 % flipped."""
    drive = read_images(data / "kitti_video" / "kitti_tracking_0001")
    numbers = [frame.number for frame in drive.frames if frame.labelled]
    boxes = read_boxes(data / "mono_detections" / "dd3d" / "kitti_tracking_0001", numbers)
    cars = [one for one in score(drive, boxes, sorted(boxes), min_score=0.5) if one.kind == "Car" and one.found]
    assert np.median([one.metres / one.distance for one in cars]) < 0.04
    assert np.median([one.degrees for one in cars]) < 3.0


def test_results_are_written_as_they_are_read(tmp_path):
    text = "Car -1.00 -1 0.0000 1.00 2.00 30.00 40.00 1.5000 1.6000 3.9000 1.0000 1.6000 20.0000 0.5000 0.7000\n"
    (tmp_path / "000000.txt").write_text(text)
    assert format_results(read_boxes(tmp_path, [0])[0]).split()[4:] == text.split()[4:]


def submission(root, name, *, shift=0.0, samples=("s0", "s1")):
    """The labelled cars of a made-up scene as nuScenes' submission, moved along the world's first axis."""
    task = name.partition(".")[0]
    tables = {path.stem: json.loads(path.read_text()) for path in root.glob("*.json")}
    results = {token: [] for token in samples}
    for one in (label for label in tables["sample_annotation"] if label["sample_token"] in samples):
        x, *rest = one["translation"]
        known = {"translation": [x + shift, *rest], "size": one["size"], "rotation": one["rotation"]}
        results[one["sample_token"]].append({**known, f"{task}_name": "car", f"{task}_score": 0.9, "tracking_id": "7"})
    path = root / name
    path.write_text(json.dumps({"meta": {}, "results": results}))
    return path


def test_boxes_of_nuscenes_are_scored(tmp_path):
    """As they are, moved by 0.5 m, and of one of two samples alone, which leaves one image."""
    from tests.formats.made_up import write_nuscenes

    folder = write_nuscenes(tmp_path / "nuscenes")
    place, out = f"{folder}#CAM_FRONT", tmp_path / "a.json"
    exact, moved = submission(folder, "detection.json"), submission(folder, "tracking.json", shift=0.5)
    done = run("evaluate", "boxes", place, exact, f"moved={moved}", "--overlap", 0.2, "--json", out)
    assert done.exit_code == 0, done.output
    assert "2 images." in done.stdout
    sources = json.loads(out.read_text())["sources"]
    errors = {one["name"]: [car["metres"] for car in one["vehicles"] if car["found"]] for one in sources}
    np.testing.assert_allclose(errors["detection"], 0.0, atol=1e-6)
    np.testing.assert_allclose(errors["moved"], 0.5, atol=1e-6)
    some = submission(folder, "detection.json", samples=("s1",))
    assert "1 image." in run("evaluate", "boxes", place, some, "--overlap", 0.2).stdout
    other = run("evaluate", "boxes", place, submission(folder, "detection.json", samples=()), "--overlap", 0.2)
    assert "Give boxes of the samples of scene-0001" in str(other.exception)
