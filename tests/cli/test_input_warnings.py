"""Files whose numbers cannot be what they are taken for are solved with a warning that says what to look for."""

import json
import re

import numpy as np
import pyarrow.parquet as pq
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.input_warnings import InputWarning, InputWarnings
from fgrecon.io.catalogue import load_category
from tests.command_line import run

CATEGORY = load_category("car14")
K = [[721.5, 0, 609.6], [0, 721.5, 172.9], [0, 0, 1]]


@pytest.fixture(scope="module")
def cars(tmp_path_factory):
    """Instances of the sample street, with their keypoints as rows (K, 3)."""
    folder = tmp_path_factory.mktemp("sample")
    assert run("sample", "--out", folder).exit_code == 0
    found = []
    for instance in json.loads((folder / "cars.json").read_text())["instances"]:
        rows = [instance["keypoints"].get(name) for name in CATEGORY.keypoints]
        found.append((instance["id"], np.array([row or [np.nan] * 3 for row in rows]), np.array(instance["box"])))
    return found


def warnings(tmp_path, cars, change, camera=K, size=(1242, 375), box=lambda box: box):
    """What is warned of once the keypoints are changed."""
    instances = []
    for name, rows, given in cars:
        points = np.column_stack([change(rows[:, :2]), rows[:, 2]])
        keypoints = [None if np.isnan(point[0]) else point.tolist() for point in points]
        instances.append({"id": name, "keypoints": keypoints, "box": box(given).tolist()})
    file = tmp_path / "cars.json"
    shared = {"K": camera} if size is None else {"K": camera, "image_size": size}
    file.write_text(json.dumps(shared | {"instances": instances}))
    return " ".join(run("reconstruct", file).stderr.split())


def test_nothing_is_said_of_keypoints_that_fit(tmp_path, cars):
    assert "Warning" not in warnings(tmp_path, cars, lambda points: points)
    assert "Warning" not in warnings(tmp_path, cars, lambda points: points, size=None)


def test_parts_of_an_image_are_no_pixels(tmp_path, cars):
    printed = warnings(tmp_path, cars, lambda points: points / [1242, 375])
    assert "All keypoints of car-1, car-2, car-3 are between 0 and 1" in printed
    normalised = np.diag([1 / 721.5, 1 / 721.5, 1]) @ K
    normalised[:2, 2] = 0.0
    printed = warnings(tmp_path, cars[:1], lambda p: np.clip((p - p[0]) / 721.5, 0, 1), normalised.tolist(), None)
    assert "between 0 and 1" not in printed  # a camera whose pixels are these


@pytest.mark.parametrize("size", [None, (1242, 375)])
def test_swapped_axes(tmp_path, cars, size):
    printed = warnings(tmp_path, cars, lambda points: points[:, ::-1], size=size)
    assert "Most keypoints of car-1, car-2 are beside the 2D box" in printed  # car-3 is where u is v


def test_images_of_a_track(tmp_path, cars):
    assert run("sample", "--out", tmp_path / "sample").exit_code == 0
    track = json.loads((tmp_path / "sample" / "TRACK.json").read_text())
    track["frames"][0]["keypoints_uv"] = [point[::-1] for point in track["frames"][0]["keypoints_uv"]]
    (tmp_path / "track.json").write_text(json.dumps(track))
    assert "Warning: track: Most keypoints of " in " ".join(run("track", tmp_path / "track.json").stderr.split())


PAIRS = dict([*CATEGORY.symmetric_pairs, *((b, a) for a, b in CATEGORY.symmetric_pairs)])


def mirrored(points):
    """Left and right exchanged."""
    return points[[PAIRS.get(k, k) for k in range(len(points))]]


def test_a_track_is_warned_of_once_and_does_not_converge(tmp_path):
    """Left and right exchanged in all of its images, and a principal point outside of them."""
    assert run("sample", "--out", tmp_path / "sample", "-q").exit_code == 0
    track = json.loads((tmp_path / "sample" / "TRACK.json").read_text())
    for frame in track["frames"]:
        for name in ("keypoints_uv", "confidence"):
            frame[name] = mirrored(np.array(frame[name], dtype=float)).tolist()
    (tmp_path / "mirrored.json").write_text(json.dumps(track))
    done = run("track", tmp_path / "mirrored.json")
    said = " ".join(done.stderr.split())
    assert said.count("Warning") == 1
    assert "left and right" in said
    assert "mirrored: weak" in done.stdout
    done = run("track", tmp_path / "sample/TRACK.json", "--intrinsics", "721.5,721.5,172.9,609.6")
    said = " ".join(done.stderr.split())
    assert said.count("Warning") == 1
    assert "principal point" in said


@pytest.fixture
def many(tmp_path, cars):
    """A file of nine vehicles in nine frames, the keypoints of all of them changed."""

    def make(change, name="many.json"):
        instances = []
        for number in range(9):
            _, rows, box = cars[number % len(cars)]
            points = [
                None if np.isnan(point[0]) else [*uv, point[2]]
                for point, uv in zip(rows.tolist(), change(rows[:, :2]).tolist(), strict=True)
            ]
            instances.append({"id": f"v{number}", "frame": number, "keypoints": points, "box": box.tolist()})
        (tmp_path / name).write_text(json.dumps({"K": K, "image_size": [1242, 375], "instances": instances}))
        return tmp_path / name

    return make


@pytest.mark.parametrize("jobs", [1, 2])
def test_contradictions_of_a_whole_file_through_batch(tmp_path, many, cars, jobs):
    instances = [
        {"id": name, "keypoints": np.nan_to_num(mirrored(rows)).tolist(), "box": box.tolist()}
        for name, rows, box in cars
    ]
    file = tmp_path / "mirrored.json"
    file.write_text(json.dumps({"K": K, "image_size": [1242, 375], "instances": instances}))
    said = said_by("batch", file, "--out", tmp_path / "mirrored", "--jobs", jobs)
    assert said.count("Warning") == 1
    assert "left and right" in said
    rows = pq.read_table(tmp_path / "mirrored").to_pylist()
    assert "converged" not in {row["status"] for row in rows}
    assert {row["input_warning"] for row in rows} == {"mirrored"}
    intrinsics = ("--intrinsics", "721.5,721.5,172.9,609.6")
    said = said_by("batch", many(lambda points: points), *intrinsics, "--out", tmp_path / "camera", "--jobs", jobs)
    assert said.count("Warning") == 1
    assert "principal point" in said
    assert "converged" not in pq.read_table(tmp_path / "camera").column("status").to_pylist()


def test_a_camera_that_contradicts_images_through_batch(tmp_path, cars):
    assert run("sample", "--out", tmp_path / "sample", "-q").exit_code == 0
    intrinsics = ("--intrinsics", "721.5,721.5,172.9,609.6")
    done = run("batch", tmp_path / "sample/street.png", *intrinsics, "--out", tmp_path / "out")
    said = " ".join(done.stderr.split())
    assert said.count("Warning") == 1
    assert "principal point" in said
    assert "converged" not in pq.read_table(tmp_path / "out").column("status").to_pylist()


CHANGES = [
    (lambda points: points / [1242, 375], "All keypoints of v0, v1, v2 and 6 more are between 0 and 1"),
    (lambda points: points[::-1], r"Hardly a keypoint of v\d, v\d, v\d and \d more fits"),
    (lambda points: points, None),
]


def said_by(*arguments):
    """What a command says beside its output, on one line."""
    return " ".join(run(*arguments).stderr.split())


@pytest.mark.parametrize(("change", "warning"), CHANGES)
def test_of_many_it_is_reported_once_with_their_number(tmp_path, many, change, warning):
    said = said_by("batch", many(change), "--out", tmp_path / "out", "--jobs", 1, "--size-prior", "apollo79")
    if warning is None:
        assert "Warning" not in said
        assert pq.read_table(tmp_path / "out").column("input_warning").null_count == 9
    else:
        (reported,) = re.findall(warning, said)
        first, more = re.findall(r"v\d", reported), int(re.search(r"(\d) more", reported)[1])
        rows = pq.read_table(tmp_path / "out").to_pylist()
        warned = [row["id"] for row in rows if row["input_warning"] is not None]
        assert first == warned[: len(first)]
        assert len(first) + more == len(warned) > 4
        assert said.count("Warning") == 1


@pytest.mark.parametrize(("change", "warning"), CHANGES)
def test_of_a_video_too(tmp_path, many, change, warning):
    said = said_by("run", many(change), "--out", tmp_path / "out", "--fps", 10, "--size-prior", "apollo79")
    if warning is None:
        assert "keypoint" not in said
    else:
        assert said.count(warning.partition("v")[0].partition(" of ")[0]) == 1
        assert " in " in said
        assert " more " in said


def test_of_a_hundred_thousand_three_names_are_kept():
    warnings = InputWarnings()
    for number in range(100_000):
        warnings.add(str(number), InputWarning.BESIDE)
    assert warnings.names == {InputWarning.BESIDE: ["0", "1", "2"]}
    (line,) = warnings.lines()
    assert "of 0, 1, 2 and 99997 more are beside" in line


def test_one_wrong_range_hides_nothing():
    """It is named though the others are right, and so is what must be wrong with most results."""
    warnings = InputWarnings(judged=3)
    for number, warning in enumerate((InputWarning.MIRRORED, InputWarning.MIRRORED, InputWarning.RANGE)):
        warnings.add(str(number), warning)
    assert ["of 0, 1 fit better" in line for line in warnings.lines()] == [True, False]
    assert "The range of 2 contradicts" in warnings.lines()[1]
    warnings.add("3", InputWarning.FACTORS)
    assert len(warnings.lines()) == 2


def test_boxes_of_another_kind(tmp_path, cars):
    printed = warnings(tmp_path, cars, lambda points: points, box=lambda box: box - [300, 0, 300, 0], size=None)
    assert "are beside the 2D box" in printed


def test_another_image(tmp_path, cars):
    printed = warnings(tmp_path, cars[:1], lambda points: points + 1500, box=lambda box: box + 1500, size=(1242, 375))
    assert "Most keypoints of car-1 are far outside of the image" in printed


def test_another_order(tmp_path, cars):
    assert "Hardly a keypoint of car-1" in warnings(tmp_path, cars[:1], lambda points: points[::-1])


def test_a_car_that_the_image_cuts_off_is_none(tmp_path, cars):
    """Three quarters of it lie outside, and its box ends at the edge."""
    name, rows, box = cars[0]
    left = box[0] + 0.75 * (box[2] - box[0])
    moved = [(name, rows - [left, 0, 0], np.maximum(box - [left, 0, left, 0], 0.0))]
    assert "Warning: Most" not in warnings(tmp_path, moved, lambda points: points)


def test_a_height_in_millimetres_is_refused(tmp_path, cars):
    for how in (["--ground=0,1,0,1650"], ["--camera-height", "165"]):
        done = run("reconstruct", tmp_path / "cars.json", "--intrinsics=700,700,600,170", *how)
        assert isinstance(done.exception, InvalidInputError)
        assert "in metres" in str(done.exception)
