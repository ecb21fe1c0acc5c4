"""What a frame needs at least: the networks' multiplications at the rate of a matrix product, and GTSAM's elimination.

Beside each stands what it takes. All on one core.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any
from unittest import mock

import gtsam
import numpy as np

from benchmarks.speed.cases import drive, streets
from benchmarks.speed.measure import Table
from factors.mixture import Form
from fgrecon import Options, Tracker
from fgrecon.perception.keypoints import on_onnx
from fgrecon.perception.keypoints.detect import KeypointCascade
from fgrecon.perception.keypoints.layout import PATCH
from fgrecon.perception.keypoints.layout import SETTINGS as CASCADE
from fgrecon.perception.keypoints.sessions import Network, at_most, open_session
from fgrecon.perception.vehicles import SETTINGS as DETECTION
from fgrecon.perception.vehicles import shipped
from fgrecon.solve import scene as scenes
from fgrecon.solve.graph import multi_start
from fgrecon.solve.graph.graph import Graph
from fgrecon.solve.graph.newton import Descent
from fgrecon.solve.graph.optimise import Optimum
from fgrecon.solve.pipeline import reconstruct
from fgrecon.solve.scene import reconstruct_scene
from fgrecon.solve.time import window

COLUMNS = ("", "G multiplications", "at least, ms", "takes, ms", "times")
VEHICLES = 8  # of a frame, about as many as drive 0095 has
_FRAMES = 12  # of a vehicle over time
_SIZE = (928, 288)  # the detector's first input for images of KITTI's shape, pixels


def networks(repeats: int) -> Table:
    """Networks of a frame of KITTI's shape with eight cars."""
    rate = _rate(repeats)
    files = _models()
    first, second = (one.area_px for one in DETECTION.passes)
    far = [32 * round(side * math.sqrt(second / first) / 32) for side in _SIZE]
    count = CASCADE.patches * VEHICLES
    inputs = {
        "car detector": [(shipped().read_bytes(), np.zeros((1, 3, h, w), np.float32)) for w, h in (_SIZE, far)],
        "KNet, crops and mirror images": [(files[0], np.zeros((2 * VEHICLES, 96, 96, 3), np.uint8))],
        "refinement": [(files[1], np.zeros((count, 3 * 14, PATCH, PATCH), np.uint8))],
    }
    table = Table(f"Networks of a frame, {VEHICLES} cars", COLUMNS)
    for name, some in inputs.items():
        work = sum(multiplications(model, values.shape) for model, values in some)
        runs = [(open_session(model, 1), values) for model, values in some]
        taken = _least(lambda runs=runs: [run(values) for run, values in runs], repeats)
        table.rows.append([name, 1e-9 * work, 1e3 * work / rate, taken, taken / (1e3 * work / rate)])
    table.rows.append(["all", *(sum(float(row[i]) for row in table.rows) for i in (1, 2, 3))])
    table.rows[-1].append(float(table.rows[-1][3]) / float(table.rows[-1][2]))
    table.notes.append(
        f"At least: at {1e-9 * rate:.0f} G multiplications a second, as a product of matrices (1024, 1024) has. "
        "Depthwise convolutions and those in groups do not come to that."
    )
    return table


def elimination(repeats: int) -> Table:
    """The linear systems of a car, a window over time and a scene: by GTSAM, and in all."""
    (street,) = streets(10, 1)
    options, given = Options(box="cuboid", keep_history=False), {"size_prior": "kitti", "ground": 1.65}
    seen, camera = [case.observation for case in street], street[0].camera
    calls: dict[str, Callable[[], object]] = {
        "a car, `reconstruct`": lambda: [reconstruct(one, camera, **given, options=options) for one in seen],
        "ten cars, `reconstruct_scene`": lambda: reconstruct_scene(seen, camera, **given, options=options),
        "a car and frame, `Tracker.update`": lambda: _followed(options),
    }
    counts = {"a car, `reconstruct`": len(seen), "a car and frame, `Tracker.update`": len(drive(_FRAMES))}
    table = Table("Linear systems", ("", "iterations", "GTSAM's elimination, ms", "takes, ms", "all of the call, ms"))
    for name, call in calls.items():
        count = counts.get(name, 1)
        with _noted() as ends:
            call()
        least = sum(one.iterations * _eliminated(graph, one, repeats) for graph, one in ends)
        solved = sum(one.iterations * _solved(graph, one, repeats) for graph, one in ends)
        every = [sum(one.iterations for _, one in ends), least, solved, _least(call, repeats)]
        table.rows.append([name, *(value / count for value in every)])
    table.notes.append("Takes: rows, derivatives and elimination of as many iterations, compiled.")
    return table


def _followed(options: Options) -> None:
    tracker = Tracker(size_prior="kitti", options=options)
    for number, case in enumerate(drive(_FRAMES)):
        tracker.update(0.1 * number, {0: case.observation}, camera=case.camera, ground=1.65)


@contextmanager
def _noted() -> Iterator[list[tuple[Graph, Optimum]]]:
    """The graphs that are optimised inside, and where each ended."""
    found: list[tuple[Graph, Optimum]] = []
    optimise = multi_start.optimise

    def noted(graph: Graph, *more: Any, **options: Any) -> Optimum:
        found.append((graph, optimise(graph, *more, **options)))
        return found[-1][1]

    with (
        mock.patch.object(multi_start, "optimise", noted),
        mock.patch.object(scenes, "optimise", noted),
        mock.patch.object(window, "optimise", noted),
    ):
        yield found


def _eliminated(graph: Graph, end: Optimum, repeats: int) -> float:
    """Milliseconds of GTSAM's elimination of a graph where it ended, and of the step by it."""
    linear = graph.build(end.state.weights, Form.NEWTON).linearize(end.values)
    ordering = gtsam.Ordering.ColamdGaussianFactorGraph(linear)
    return _least(lambda: linear.optimize(ordering), repeats)


def _solved(graph: Graph, end: Optimum, repeats: int) -> float:
    """Milliseconds of a step of the loop, from values to the step."""
    loop = Descent(graph, end.state)
    point = graph.system(loop.values).point(loop.values)
    weights = graph.reweigh_at(point, loop.weights)
    return _least(lambda: graph.step(point, weights, Form.NEWTON), repeats)


def multiplications(model: bytes, shape: Sequence[int]) -> int:
    """How many multiplications convolutions and products of matrices of an ONNX file make of an input of a shape."""
    import onnx

    loaded = onnx.load_from_string(model)
    entry = loaded.graph.input[0].type.tensor_type.shape
    for dimension, size in zip(entry.dim, shape, strict=True):
        dimension.dim_value = size
    graph = onnx.shape_inference.infer_shapes(loaded, data_prop=True).graph
    known = {one.name: tuple(one.dims) for one in graph.initializer}
    for one in (*graph.value_info, *graph.input, *graph.output):
        known[one.name] = tuple(d.dim_value for d in one.type.tensor_type.shape.dim)
    total = 0
    for node in graph.node:
        if node.op_type == "Conv":
            total += math.prod(known[node.output[0]]) * math.prod(known[node.input[1]][1:])
        elif node.op_type in ("MatMul", "Gemm"):
            total += math.prod(known[node.output[0]]) * known[node.input[0]][-1]
    return total


def _models() -> list[bytes]:
    """The files of KNet and of the refinement networks."""
    found: list[bytes] = []

    def kept(model: bytes, threads: int, device: str) -> Network:
        found.append(model)
        return open_session(model, threads, device)

    with mock.patch.object(on_onnx, "open_session", kept), at_most(1):
        KeypointCascade(runtime="onnx")
    return found


def _rate(repeats: int) -> float:
    """Multiplications a second of a product of matrices by ONNX Runtime."""
    from onnx import TensorProto, helper

    side = 1024
    ends = [helper.make_tensor_value_info(name, TensorProto.FLOAT, (side, side)) for name in ("one", "product")]
    graph = helper.make_graph([helper.make_node("MatMul", ["one", "one"], ["product"])], "product", ends[:1], ends[1:])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    run, values = open_session(model.SerializeToString(), 1), np.ones((side, side), np.float32)
    return 1e3 * side**3 / _least(lambda: run(values), repeats)


def _least(call: Callable[[], object], repeats: int) -> float:
    """Least milliseconds of CPU of some calls, after one that does not count."""
    call()
    taken = []
    for _ in range(repeats):
        before = time.process_time()
        call()
        taken.append(1e3 * (time.process_time() - before))
    return min(taken)
