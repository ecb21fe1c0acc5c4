"""Every example runs, is short, starts with its factor graph, and shows what it promises."""

import re
import runpy
import sys

import numpy as np
import pytest

from fgrecon.viz import replay

from .conftest import REPOSITORY

EXAMPLES = sorted((REPOSITORY / "examples").glob("*.py"))
NUMBER = r"(-?\d+\.\d+)"


def run(name, capsys):
    (file,) = [example for example in EXAMPLES if example.name.startswith(name)]
    runpy.run_path(str(file), run_name="__main__")
    return capsys.readouterr().out


def test_they_are_numbered_without_a_gap():
    assert [example.name[:2] for example in EXAMPLES] == [f"{i:02d}" for i in range(1, len(EXAMPLES) + 1)]


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.stem)
def test_they_are_short_and_start_with_their_factor_graph(example):
    text = example.read_text()
    assert text.count("\n") < 60
    assert "----" in text.split('"""')[1]


def test_one_car(capsys):
    output = run("01", capsys)
    yaw, true_yaw = map(float, re.search(f"yaw {NUMBER} degrees, true {NUMBER}", output).groups())
    assert abs(yaw - true_yaw) < 5.0
    assert output.startswith("converged")
    assert len(re.findall(r" (yes|no)$", output, re.MULTILINE)) == 14


def test_own_factor(capsys):
    camera_only, with_radar = map(float, re.findall(f"off by {NUMBER} m", run("02", capsys)))
    assert with_radar < 0.3 < camera_only


def test_own_category(capsys):
    output = run("03", capsys)
    yaw, true_yaw = map(float, re.search(rf"yaw {NUMBER} \(true {NUMBER}\)", output).groups())
    assert abs(yaw - true_yaw) < 2.0
    assert output.startswith("converged")


def test_track(capsys, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["04_track.py"])
    output = run("04", capsys)
    together, alone = map(float, re.search(rf"off by {NUMBER} cm, image by image {NUMBER} cm", output).groups())
    assert together < alone
    assert output.startswith("converged")
    assert np.median([float(off) for off in re.findall(rf"off by {NUMBER} m", output)]) < 1.0


def test_track_records_when_asked(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["04_track.py", str(tmp_path / "track.rrd")])
    run("04", capsys)
    back = replay.read(tmp_path / "track.rrd")
    assert len(back.frames) == 12
    assert len(back.joint) > 0


def test_learn_a_prior(capsys):
    output = run("05", capsys)
    assert float(re.search(f"mean shape off by {NUMBER} cm", output)[1]) < 8.0
    yaw, true_yaw = map(float, re.search(f"yaw {NUMBER} degrees, true {NUMBER}", output).groups())
    assert abs(yaw - true_yaw) < 3.0


def test_car_from_image(capsys):
    output = run("06", capsys)
    assert output.startswith("1 car in the image")
    assert "converged" in output
    yaw, true_yaw = map(float, re.search(f"yaw {NUMBER} degrees, true {NUMBER}", output).groups())
    assert abs(yaw - true_yaw) < 5.0
    assert len(re.findall(r" (yes|no)$", output, re.MULTILINE)) == 14


def test_own_network(capsys):
    output = run("07", capsys)
    assert output.startswith("Reconstruction: weak. Keypoints of weight")  # it finds a few alone
    yaw, true_yaw = map(float, re.findall(f"rotation_y {NUMBER} degrees", output))
    assert abs(yaw - true_yaw) < 5.0


def test_many_cars(capsys):
    lines = run("08", capsys).splitlines()
    assert len(lines) == 6
    assert lines[4].startswith("car-4: refused: box: got [5.0, 5.0, 5.0, 9.0]")
    yaws = [tuple(map(float, re.findall(NUMBER, line.partition(",")[2]))) for line in lines if "yaw" in line]
    turns = [abs((yaw - true + 180) % 360 - 180) for yaw, true in yaws]
    assert len(turns) == 5
    assert np.median(turns) < 5.0


def test_a_car_is_followed_online(capsys):
    output = run("09", capsys)
    speeds = [float(speed) for speed in re.findall(rf", {NUMBER} m/s", output)]
    assert len(speeds) == 19
    assert speeds[-1] == pytest.approx(6.0, abs=0.3)
    first, *_, last = [float(off) for off in re.findall(rf": off by {NUMBER} m, facing", output)]
    assert last < first


def test_video(capsys):
    lines = run("10", capsys).splitlines()
    assert lines[0] == "6 frames, cars: {0: 6}"
    off = [float(re.search(rf"off by {NUMBER} m", line)[1]) for line in lines[1:]]
    assert len(off) == 6
    assert np.median(off) < 1.5
    assert float(re.search(rf"{NUMBER} m/s", lines[-1])[1]) == pytest.approx(13.0, abs=4.0)


def test_lidar_and_camera(capsys):
    camera_only, with_lidar = map(float, re.findall(f"off by {NUMBER} m", run("11", capsys)))
    assert with_lidar < 0.1 < camera_only


def test_radar_over_time(capsys):
    lines = run("12", capsys).splitlines()
    rows = [(line, float(re.search(f"off by {NUMBER} m", line)[1]), float(line.split()[-2])) for line in lines]
    (_, off, _), (_, off_with, speed_with) = [
        [row for row in rows if name in row[0]][-1] for name in ("camera alone", "with the radar")
    ]
    assert off_with < 0.3 < off
    assert speed_with == pytest.approx(15.0, abs=0.3)
