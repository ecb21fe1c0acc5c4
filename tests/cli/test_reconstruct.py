"""`fgrecon reconstruct` from the outside: inputs, outputs, exit codes."""

import json
import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner

from fgrecon.batch import solve_tasks
from fgrecon.batch.vehicle_tasks import VehicleTask
from fgrecon.cli import main
from fgrecon.cli.reconstruct_report import print_table
from fgrecon.cli.terminal import Screen
from fgrecon.core.camera import Camera
from fgrecon.core.errors import DegenerateProblemError, FgreconError, InvalidInputError
from fgrecon.core.reconstruction import Reconstruction, Status
from fgrecon.io.catalogue import load_category
from fgrecon.io.images import read_image, write_png
from fgrecon.io.keypoint_file import Instance
from fgrecon.solve import pipeline
from fgrecon.viz.replay import read as replay
from tests.docs.test_schemas import check

from .conftest import INTRINSICS, LOCATION, YAW, K, car


def run(*arguments):
    return CliRunner().invoke(main.app, ["reconstruct", *map(str, arguments)])


def results(output):
    """Id -> entry of the JSON document."""
    return {entry["id"]: entry for entry in json.loads(output)["instances"]}


def test_one_car(write, instance):
    done = run(write(instance), INTRINSICS)
    assert done.exit_code == 0, done.output
    row = re.search(r"converged\s+([-\d.]+)\s+([-\d.]+), ([-\d.]+), ([-\d.]+)", done.stdout)
    yaw, *location = map(float, row.groups())
    assert yaw == pytest.approx(np.degrees(YAW), abs=1.0)
    assert location == pytest.approx(LOCATION, abs=0.15)


def test_json_stands_alone_on_the_output_and_is_a_whole_result(write, instance):
    known = ("--size-prior", "4.58,1.8,1.59", "--camera-height", 1.65)
    done = run(write(instance), INTRINSICS, "--json", "-", "--history", *known)
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    assert document["settings"]["ground"] == {"normal": [0.0, 1.0, 0.0], "distance": 1.65}
    assert document["settings"]["size_prior"]["mean"] == [4.58, 1.8, 1.59]
    entry = results(done.stdout)["0"]
    assert entry["rotation_y"] == pytest.approx(YAW, abs=0.02)
    assert entry["location"] == pytest.approx(LOCATION, abs=0.15)
    result = Reconstruction.from_dict(entry["result"])
    assert result.status is Status.CONVERGED
    assert result.location.tolist() == entry["location"]
    assert len(result.diagnostics.history) > 3
    assert "converged" in done.stderr


def test_the_side_of_the_traffic_is_a_setting(write, instance):
    given = run(write(instance), INTRINSICS, "--traffic", "right", "--json", "-")
    assert given.exit_code == 0, given.output
    assert json.loads(given.stdout)["settings"]["traffic"] == "right"
    check("results", json.loads(given.stdout))
    without = run(write(instance), INTRINSICS, "--json", "-")
    assert "traffic" not in json.loads(without.stdout)["settings"]
    assert results(without.stdout)["0"]["result"]["energies"] == results(given.stdout)["0"]["result"]["energies"]
    refused = run(write(instance), INTRINSICS, "--traffic", "middle")
    assert refused.exit_code == 2
    assert "right" in refused.output


def test_several_cars_of_which_one_is_refused(write, tmp_path):
    cars = [car() | {"id": "near"}, car() | {"id": "flat", "box": [5, 5, 5, 9]}, car(0.5, (3, 1.65, 20)) | {"id": 7}]
    out = tmp_path / "out.json"
    done = run(write({"K": K.tolist(), "instances": cars}), "--json", out)
    assert done.exit_code == 0, done.output
    assert "refused" in done.stdout
    entries = results(out.read_text())
    assert list(entries) == ["near", "flat", "7"]
    assert entries["flat"]["result"] is None
    assert entries["flat"]["error"]["field"] == "box"
    assert entries["7"]["rotation_y"] == pytest.approx(0.5, abs=0.02)


def test_several_processes_give_the_same_results(write, tmp_path):
    cars = [car(0.3 * i, (0.4 * i - 2, 1.65, 9.0 + i)) | {"id": f"car {i}"} for i in range(10)]
    cars[3]["box"], cars[6]["keypoints"] = [5, 5, 5, 9], [None] * 14
    file = write({"K": K.tolist(), "instances": cars})
    found = [json.loads(run(file, "--json", "-", "--jobs", jobs).stdout)["instances"] for jobs in (1, 2)]
    for entry in (*found[0], *found[1]):
        (entry["result"] or {}).pop("milliseconds", None)
    assert found[0] == found[1]
    assert found[1][3]["error"]["field"] == "box"
    assert found[1][6]["error"]["type"] == "DegenerateProblemError"


def test_pictures_and_recordings(write, tmp_path):
    cars = write([car() | {"id": "a/b"}, car(1.0) | {"id": "c"}])
    image = write_png(tmp_path / "image.png", np.full((375, 1242, 3), 90, np.uint8))
    sheet, one, record = tmp_path / "sheet.png", tmp_path / "one.svg", tmp_path / "run.rrd"
    assert run(cars, INTRINSICS, "--image", image, "--picture", sheet, "--save", record).exit_code == 0
    assert read_image(sheet).std() > 10
    assert sorted(path.name for path in tmp_path.glob("*.rrd")) == ["run.rrd"]  # one for all
    recorded = replay(record)
    assert list(recorded.vehicles) == ["a-b", "c"]
    assert [stage.stage for stage in recorded.summary()][-1] == "joint"
    assert run(write(car(), "car.json"), INTRINSICS, "--picture", one, "--no-joint", "--save", record).exit_code == 0
    assert one.read_text().startswith("<?xml")
    assert [stage.stage for stage in replay(record).summary()][-1] == "shape"


def test_a_picture_is_the_scene_unless_a_sheet_is_asked_for(write, tmp_path):
    cars = [car() | {"id": "a"}, car(1.0, [2.0, 1.65, 14.0]) | {"id": "a name that is long"}]
    file, given = write(cars), [INTRINSICS, "--camera-height", 1.65]
    sizes = {}
    for name, more in {"scene": [], "sheet": ["--sheet"], "together": ["--together"]}.items():
        picture = tmp_path / f"{name}.png"
        assert run(file, *given, *more, "--picture", picture).exit_code == 0
        sizes[name] = read_image(picture).shape
    assert sizes["scene"][1] == sizes["together"][1] > 1200  # 8 cm, fine enough for the photograph
    assert sizes["sheet"] != sizes["scene"]
    several = [one | {"image": f"{number}.png"} for number, one in enumerate(cars)]
    picture = tmp_path / "several.png"
    assert run(write(several, "several.json"), *given, "--picture", picture).exit_code == 0
    assert read_image(picture).shape == sizes["sheet"]  # they have no image in common
    assert "--picture" in str(run(file, INTRINSICS, "--sheet").exception)


def test_the_size_of_the_image_is_used(write, tmp_path):
    image = write_png(tmp_path / "image.png", np.zeros((375, 1242, 3), np.uint8))
    done = run(write(car()), INTRINSICS, "--image", image, "--json", "-")
    assert results(done.stdout)["0"]["camera"]["image_size"] == [1242, 375]


def test_kitti_calibration_gives_camera_and_label_frame(write, tmp_path):
    offset = np.array([0.06, -0.01, 0.02])
    numbers = np.hstack([K, (K @ offset)[:, None]]).ravel()
    calib = tmp_path / "calib.txt"
    calib.write_text(f"P0: 1 2 3\nP2: {' '.join(map(str, numbers))}\n")
    done = run(write(car()), "--calib", calib, "--json", "-")
    entry = results(done.stdout)["0"]
    assert entry["camera"]["matrix"] == K.tolist()
    assert np.subtract(entry["location"], entry["location_in_label_frame"]) == pytest.approx(offset)


def test_lens_distortion(write):
    coefficients = np.array([-0.3, 0.1, 0.001, -0.002, 0.0])
    location = np.array([-6.0, 1.65, 10.0])  # far from the middle of the image
    distorted = write(car(YAW, location, Camera(K, coefficients)))
    given = run(distorted, INTRINSICS, "--distortion=-0.3,0.1,0.001,-0.002,0", "--json", "-")
    assert results(given.stdout)["0"]["location"] == pytest.approx(location, abs=0.15)
    ignored = run(distorted, INTRINSICS, "--json", "-")
    assert np.linalg.norm(results(ignored.stdout)["0"]["location"] - location) > 0.5


@pytest.mark.parametrize("strategy", ["paper", "huber", "cauchy", "geman_mcclure", "tukey", "gnc"])
def test_every_strategy_runs(write, strategy):
    done = run(write(car()), INTRINSICS, "--strategy", strategy, "--json", "-", "--free-offsets", "--box-model", "off")
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["settings"]["strategy"] == strategy
    assert results(done.stdout)["0"]["rotation_y"] == pytest.approx(YAW, abs=0.05)


def test_a_track_is_read_too(write):
    seen = car()
    track = {
        "K": K.tolist(),
        "P2": np.hstack([K, np.zeros((3, 1))]).tolist(),
        "keypoint_names": list(load_category("car14").keypoints),
        "frames": [
            {
                "frame": frame,
                "keypoints_uv": keypoints,
                "confidence": seen["confidence"],
                "box_xyxy": seen["box"],
                "gt": {"location": LOCATION.tolist(), "rotation_y": YAW},
            }
            for frame, keypoints in ((3, seen["keypoints"]), (4, [[None, None]] * 14))
        ],
    }
    done = run(write(track, "track.json"), "--json", "-")
    assert done.exit_code == 0, done.output
    entries = results(done.stdout)
    assert entries["track:3"]["location_in_label_frame"] == pytest.approx(LOCATION, abs=0.15)
    assert entries["track:4"]["error"]["type"] == "DegenerateProblemError"
    done = run(write(track, "track.json"), "--together", "--json", "-")
    assert done.exit_code == 0, done.output
    scenes = json.loads(done.stdout)["scenes"]
    assert [scene["image"] for scene in scenes] == ["track:3", "track:4"]  # one vehicle in two images, not two


def test_unknown_fields_are_reported(write, instance):
    done = run(write(instance | {"confidences": [1.0] * 14}), INTRINSICS)
    assert "confidences" in done.stdout


def change(**fields):
    return lambda instance: instance | fields


def points(edit):
    return lambda instance: instance | {"keypoints": edit(instance["keypoints"])}


BAD = {  # what a car's numbers may be, and the field that the error names
    "too few points": (points(lambda p: [*p[:2], *[None] * 12]), "keypoints"),
    "no point at all": (points(lambda _: [None] * 14), "keypoints"),
    "points on a line": (points(lambda p: [[10.0 * i, 5.0 * i] for i in range(len(p))]), "keypoints"),
    "points in one place": (points(lambda p: [[10.0, 5.0]] * len(p)), "keypoints"),
    "NaN": (points(lambda p: [[float("nan"), 4.0], *p[1:]]), "keypoints[0][0]"),
    "infinity": (points(lambda p: [[float("inf"), 4.0], *p[1:]]), "keypoints[0][0]"),
    "too many points": (points(lambda p: [*p, [1.0, 2.0]]), "keypoints"),
    "points without v": (points(lambda p: [[u] for u, _ in p]), "keypoints[0]"),
    "no list": (change(keypoints="none"), "keypoints"),
    "a box of no size": (change(box=[5, 5, 5, 9]), "box"),
    "half a box": (change(box=[5, 5]), "box"),
    "all weights zero": (change(confidence=[0.0] * 14), "confidence"),
    "confidence above 1": (change(confidence=[1.5] * 14), "confidence"),
    "a confidence too few": (change(confidence=[0.5] * 13), "confidence"),
    "covariance not positive": (change(covariance=[[[1, 2], [2, 1]]] * 14), "covariance"),
    "singular camera matrix": (change(K=[[0, 0, 600], [0, 0, 180], [0, 0, 1]]), "K"),
    "camera matrix with NaN": (change(K=[[float("nan"), 0, 600], [0, 7, 180], [0, 0, 1]]), "K[0][0]"),
    "camera matrix of wrong shape": (change(K=[[700, 0], [0, 700]]), "K"),
}


@pytest.mark.parametrize(("spoil", "field"), BAD.values(), ids=BAD)
def test_bad_input_names_the_field(write, instance, spoil, field):
    file = write(spoil(instance | {"K": K.tolist()}))
    done = run(file)
    assert isinstance(done.exception, InvalidInputError), done.output
    assert done.exception.field == f"{file}: {field}"
    assert done.exception.fix


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ([], "intrinsics"),
        (["--intrinsics", "1,2,3"], "intrinsics"),
        (["--intrinsics", "0,0,5,5"], "intrinsics"),
        ([INTRINSICS, "--calib", "none.txt"], "intrinsics"),
        (["--calib", "none.txt"], "calib"),
        ([INTRINSICS, "--distortion", "1,2,3"], "distortion"),
        ([INTRINSICS, "--prior", "none"], "prior"),
        ([INTRINSICS, "--ground", "0,1,0"], "ground"),
        ([INTRINSICS, "--ground", "0,1,0,1.6", "--camera-height", "1.6"], "camera_height"),
        ([INTRINSICS, "--camera-height", "nan"], "camera_height"),
        ([INTRINSICS, "--camera-height", "-1.65"], "camera_height"),
        ([INTRINSICS, "--ground", "0,1,0,-1.6"], "ground.distance"),
        ([INTRINSICS, "--size-prior", "big"], "size_prior"),
        ([INTRINSICS, "--size-prior", "4,1.8,-1"], "size_prior.mean"),
        ([INTRINSICS, "--image", "none.png"], "image"),
        ([INTRINSICS, "--picture", "car.gif"], "picture"),
        ([INTRINSICS, "--save", "car.mp4"], "save"),
        ([INTRINSICS, "--json", "no/such/folder/out.json"], "output"),
    ],
)
def test_bad_options_name_the_field(write, instance, arguments, field):
    done = run(write(instance), *arguments)
    assert isinstance(done.exception, InvalidInputError), done.output
    assert done.exception.field == field


@pytest.mark.parametrize("width", [100, 180])
def test_reasons_are_whole_below_the_table(capsys, width):
    reason = "The keypoints with any weight leave pose or shape undetermined and " + "so on " * 9 + "to the end"
    nothing = Instance("car", np.full((14, 2), np.nan))
    outcome = solve_tasks.Outcome(VehicleTask(nothing, Camera(K)), None, FgreconError(reason))
    screen = Screen(error=False, quiet=False, verbose=False, progress=False)
    screen.console = Console(width=width, highlight=False, soft_wrap=True)
    print_table(screen, [outcome])
    shown = capsys.readouterr().out
    assert set(reason.split()) <= set(shown.split())


def test_an_image_that_is_none_and_one_of_another_size(write, instance, tmp_path):
    broken = tmp_path / "broken.png"
    broken.write_bytes(b"no image")
    assert run(write(instance), INTRINSICS, "--image", broken).exception.field == "image"
    small = write_png(tmp_path / "small.png", np.zeros((10, 10, 3), np.uint8))
    sized = write(instance | {"K": K.tolist(), "image_size": [1242, 375]})
    assert run(sized, "--image", small).exception.field == "image"


def test_when_all_are_refused_the_first_reason_is_printed_and_the_json_is_written(write, tmp_path):
    nothing = [None] * 14
    file = write([car() | {"id": "a", "keypoints": nothing}, car() | {"id": "b", "keypoints": nothing}])
    out = tmp_path / "out.json"
    done = run(file, INTRINSICS, "--json", out)
    assert isinstance(done.exception, DegenerateProblemError)
    assert done.exception.field == f"{file}: instance a: keypoints"
    assert list(results(out.read_text())) == ["a", "b"]


def test_a_solver_that_fails_on_all_gives_exit_code_1(write, instance, monkeypatch):
    def failing(*arguments, **settings):
        return replace(pipeline.reconstruct(*arguments, **settings), status=Status.FAILED, message="made to fail")

    monkeypatch.setattr(solve_tasks, "reconstruct", failing)
    done = run(write(instance), INTRINSICS)
    assert done.exit_code == 1
    assert "made to fail" in done.stdout
    quiet = run(write(instance), INTRINSICS, "--quiet")
    assert quiet.exit_code == 1
    assert quiet.output == "fgrecon: No vehicle could be reconstructed.\n"


def test_the_table_has_a_few_words_and_verbose_has_all_of_them(write, monkeypatch):
    long = "The solver was stopped early: " + "near a minimum, " * 9
    degenerate = {"status": Status.DEGENERATE, "message": long}
    monkeypatch.setattr(
        solve_tasks, "reconstruct", lambda *a, **k: replace(pipeline.reconstruct(*a, **k), **degenerate)
    )
    file = write([car() | {"id": "a"}, car() | {"id": "b", "box": [5, 5, 5, 9]}])
    shown = run(file, INTRINSICS)
    assert shown.exit_code == 0, shown.output
    assert re.search(r"^a +degenerate ", shown.stdout, re.MULTILINE)
    assert re.search(r"^b +refused ", shown.stdout, re.MULTILINE)
    assert re.search(r"^a: The solver was stopped early *$", shown.stdout, re.MULTILINE)
    assert re.search(r"^b: box: ", shown.stdout, re.MULTILINE)
    assert max(map(len, shown.stdout.splitlines())) <= 80
    verbose = run(file, INTRINSICS, "-v")
    assert f"a: {long}" in verbose.stdout
    assert "energies (nats): reprojection" in verbose.stdout
    assert "times (ms): pose" in verbose.stdout
    assert "b: box: got" in verbose.stdout
    documents = results(run(file, INTRINSICS, "--json", "-").stdout)
    assert documents["a"]["result"]["message"] == long


def test_every_file_is_said(write, tmp_path):
    image = write_png(tmp_path / "i.png", np.zeros((375, 1242, 3), np.uint8))
    names = {"--json": "r.json", "--picture": "p.png", "--save": "s.rrd"}
    outputs = [part for option, name in names.items() for part in (option, tmp_path / name)]
    done = run(write(car()), INTRINSICS, "--image", image, *outputs)
    assert done.stdout.splitlines()[-3:] == [f"Wrote {tmp_path / name}." for name in names.values()]


@pytest.mark.parametrize(
    ("content", "arguments", "start"),
    [
        (b"{", [INTRINSICS], "{file}: got Expecting property name"),
        (b"[]", [INTRINSICS], "{file}: instances: got []."),
        (b"7", [INTRINSICS], "{file}: got 7. Give a JSON object."),
        (b'{"K": 1}', [INTRINSICS], "{file}: keypoints: got nothing."),
        (None, [INTRINSICS], "file: got {file}. Give a file that can be read (No such file or directory)."),
    ],
    ids=["broken", "empty", "a number", "no keypoints", "no file"],
)
def test_bad_files_are_one_line_and_exit_code_2(tmp_path, content, arguments, start):
    file = tmp_path / "cars.json"
    if content is not None:
        file.write_bytes(content)
    command = [sys.executable, "-c", "from fgrecon.cli.main import main; main()", "reconstruct", str(file), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith(f"fgrecon: {start.format(file=file)}")
    assert done.stderr.count("\n") == 1


@pytest.mark.data
def test_a_real_track(data):
    """Network keypoints on KITTI: positions in the label's frame are within a metre on most frames."""
    file = data / "kitti_tracking_keypoints14" / "seq0010_track00_from000.json"
    done = run(file, "--size-prior", "kitti", "--camera-height", 1.65, "--box-model", "cuboid", "--json", "-")
    assert done.exit_code == 0, done.output
    labels = [frame["gt"] for frame in json.loads(file.read_text())["frames"]]
    entries = json.loads(done.stdout)["instances"]
    turns = [entry["rotation_y"] - label["rotation_y"] for entry, label in zip(entries, labels, strict=True)]
    assert np.abs(np.angle(np.exp(1j * np.array(turns)))).max() < np.radians(10)
    places = [np.subtract(e["location_in_label_frame"], g["location"]) for e, g in zip(entries, labels, strict=True)]
    assert np.median(np.linalg.norm(places, axis=1)) < 1.0


def test_kind_and_score_of_a_detector_come_back_in_exports(write, instance, tmp_path):
    given = {"instances": [{**instance, "id": "a", "kind": "Van", "score": 0.25}, {**instance, "id": "b"}]}
    out = tmp_path / "out.json"
    assert run(write(given), INTRINSICS, "--json", out).exit_code == 0
    first, second = json.loads(out.read_text())["instances"]
    assert (first["kind"], first["score"]) == ("Van", 0.25)
    assert not {"kind", "score"} & set(second)
    batched = tmp_path / "batch"
    again = CliRunner().invoke(main.app, ["batch", str(write(given)), INTRINSICS, "--out", str(batched)])
    assert again.exit_code == 0
    for results, kinds in ((out, ["Van", "Car"]), (batched, ["Van", "Car"])):
        exported = CliRunner().invoke(main.app, ["export", str(results), str(tmp_path / "kitti.txt")])
        assert exported.exit_code == 0, exported.output
        lines = [line.split() for line in (tmp_path / "kitti.txt").read_text().splitlines()]
        assert [line[0] for line in lines] == kinds
        assert float(lines[0][-1]) == 0.25
        assert float(lines[1][-1]) > 0.3  # by its keypoints
