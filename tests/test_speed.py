"""`benchmarks.speed`: its statistics, its worker processes, and that its parts still fit the solver."""

import json

import numpy as np
import pytest

from benchmarks.speed import worker
from benchmarks.speed.authors import authors
from benchmarks.speed.builds import REPOSITORY, THIS, Build, base_build
from benchmarks.speed.cases import drive, hard_cars, streets, write_cases
from benchmarks.speed.floors import multiplications
from benchmarks.speed.measure import Arm, Table, interleaved, timing_rows
from benchmarks.speed.side_by_side import SideBySide, timed
from benchmarks.speed.stages import Car, pose_difference, stages
from fgrecon.core.options import BoxModel, Options
from fgrecon.io.catalogue import load_prior
from fgrecon.simulation.vehicles import KITTI_CAMERA
from fgrecon.solve.pipeline import reconstruct

from .cars import yaw_pose


def test_rows_run_in_turn_and_every_other_round_backwards():
    ran = []

    def row(name):
        return [lambda name=name, car=car: ran.append((name, car)) or (len(ran), 0.0) for car in range(2)]

    taken = interleaved({"a": row("a"), "b": row("b")}, repeats=2)
    assert ran == [("a", 0), ("b", 0), ("a", 1), ("b", 1), ("b", 0), ("a", 0), ("b", 1), ("a", 1)]
    np.testing.assert_array_equal(taken["a"][..., 0], [[1, 6], [3, 8]])


def test_rows_of_a_table_are_of_the_least_of_the_repeats():
    cpu = np.array([[3.0, 1.0], [2.0, 4.0], [9.0, 9.0]])
    first = np.stack([cpu, cpu + 1.0], axis=-1)
    (name, median, mean, p5, p95, worst, wall, ratio, _), other = timing_rows({"now": first, "then": 2.0 * first})
    assert (name, median, mean, worst, wall, ratio) == ("now", 2.0, 4.0, 9.0, 3.0, 1.0)
    assert p5 == pytest.approx(1.1)
    assert p95 == pytest.approx(8.3)
    assert other[1:3] == [4.0, 8.0]
    assert other[-2:] == [2.0, "2-2"]


def test_a_table_is_markdown():
    table = Table("Tracks", ("images", "ms"), [["15", 36.4567]], ["Flat."])
    assert table.markdown() == "### Tracks\n\n| images | ms |\n| --- | ---: |\n| 15 | 36.46 |\n\nFlat.\n"


def test_a_pose_differs_by_metres_and_degrees():
    metres, degrees = pose_difference(yaw_pose(0.2, (0, 0, 9)), yaw_pose(0.2 + np.pi / 2, (3, 0, 13)))
    assert (metres, degrees) == (pytest.approx(5.0), pytest.approx(90.0))


def test_a_worker_solves_as_this_process_does(tmp_path):
    (case,) = hard_cars(1)
    options = Options(box=BoxModel(case.box_model), keep_history=False)
    here = reconstruct(case.observation, case.camera, ground=case.ground, size_prior=case.size, options=options)
    with Arm(write_cases(tmp_path / "cases.json", [case])) as arm:
        answer, memory = arm.ask(solve=0), arm.ask(memory=None)["memory"]
        times = arm.clock(0, [{}])()
        bits = arm.ask(bits=[0])
    assert answer["digest"] == worker.digest(here)
    assert np.array_equal(answer["pose"], here.camera_T_object)
    assert min(answer["cpu"], answer["wall"], *times) > 1.0
    assert memory > 20.0
    assert all(found == [answer["digest"]] for found in bits.values())
    assert {"one thread", "eight threads"} <= set(bits)


def test_a_worker_solves_a_scene_and_follows_vehicles(tmp_path):
    (street,) = streets(2, 1)
    frames = [
        {"time": 0.1 * number, "world_T_camera": np.eye(4).tolist(), "vehicles": {"7": _plain(street[0].observation)}}
        for number in range(2)
    ]
    content = {"camera": KITTI_CAMERA.matrix.tolist(), "ground": 1.65, "size": "kitti", "frames": frames}
    (tmp_path / "frames.json").write_text(json.dumps(content), encoding="utf-8")
    with Arm(write_cases(tmp_path / "cases.json", street)) as arm:
        assert arm.ask(scene=[0, 1])["cpu"] > 1.0
        taken = arm.ask(frames=str(tmp_path / "frames.json"))["cpu"]
    assert len(taken) == 2
    assert min(taken) > 0.5


def _plain(seen):
    return {"keypoints": seen.keypoints.tolist(), "confidence": seen.confidence.tolist(), "box": seen.box.tolist()}


def test_builds_are_measured_in_turn_and_divided_by_the_first(tmp_path):
    ran = []

    def measure(build):
        ran.append(build.name)
        return {"ms": {"base": 4.0, "this": 1.0}[build.name] * len(ran)}

    both = SideBySide((Build("base"), Build("this")), tmp_path, tmp_path, repeats=2)
    assert both.rows("solve", measure) == [["solve: ms", 10.0, "4-16", 2.5, "2-3", 0.34375, "0.188-0.5"]]
    assert ran == ["base", "this", "this", "base"]


def test_a_command_is_timed_and_its_errors_are_reported(tmp_path):
    used = timed(THIS, ["-c", "print(sum(range(10**6)))"], tmp_path)
    assert 0.0 < used["CPU, s"] < 60.0
    assert used["memory, MB"] > 5.0
    with pytest.raises(RuntimeError, match="ended with 3: no frames"):
        timed(THIS, ["-c", "print('no frames'); raise SystemExit(3)"], tmp_path)


def test_a_build_that_is_there_is_taken_as_it_is(tmp_path):
    (tmp_path / "finished").write_text("abc", encoding="ascii")
    build = base_build(tmp_path, "abc")
    assert build.python == tmp_path / "environment" / "bin" / "python"
    assert "PYTHONPATH" not in build.environment
    assert THIS.environment["PYTHONPATH"].startswith(str(REPOSITORY))


def test_a_worker_that_fails_says_so(tmp_path):
    with Arm(write_cases(tmp_path / "cases.json", [])) as arm, pytest.raises(RuntimeError, match="ended with 1"):
        arm.ask(solve=0)


def test_a_worker_solves_a_track(tmp_path):
    with Arm(write_cases(tmp_path / "cases.json", drive(3))) as arm:
        answer = arm.ask(track=[0, 1, 2])
    assert set(answer["stages"]) == {"pose", "joint"}
    assert answer["cpu"] > 3.0


def test_the_stages_fit_the_solver_and_end_at_the_minimum():
    car = Car.of(*hard_cars(1), load_prior("car14"))
    for name, (call,) in stages([car]).items():
        assert min(call()) > 0.0, name
    metres, degrees = car.from_the_minimum(steps=2)
    assert metres < 1e-5
    assert degrees < 1e-5


def test_without_the_authors_source_their_row_is_left_out(tmp_path):
    table = authors([], tmp_path, tmp_path, 1)
    assert table.rows == []
    assert "--authors" in table.notes[0]


def test_multiplications_are_those_of_convolutions_and_products():
    onnx = pytest.importorskip("onnx")
    helper, rng = onnx.helper, np.random.default_rng(0)
    kernel, matrix = rng.random((6, 2, 3, 3), dtype=np.float32), rng.random((5, 7), dtype=np.float32)
    nodes = [
        helper.make_node("Conv", ["image", "kernel"], ["map"], group=2, strides=[2, 2], pads=[1, 1, 1, 1]),
        helper.make_node("MatMul", ["map", "matrix"], ["end"]),
    ]
    entry = helper.make_tensor_value_info("image", onnx.TensorProto.FLOAT, ("count", 4, 8, 10))
    end = helper.make_tensor_value_info("end", onnx.TensorProto.FLOAT, None)
    weights = [onnx.numpy_helper.from_array(array, name) for name, array in (("kernel", kernel), ("matrix", matrix))]
    model = helper.make_model(helper.make_graph(nodes, "network", [entry], [end], weights))
    of_an_image = 6 * 4 * 5 * (2 * 3 * 3) + 6 * 4 * 7 * 5
    assert multiplications(model.SerializeToString(), (3, 4, 8, 10)) == 3 * of_an_image
