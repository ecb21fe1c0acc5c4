"""The parts of the report, apart from the versions side by side (`arms`) and the authors' program (`authors`)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.speed.arms import NUMPY
from benchmarks.speed.cases import Case, drive, streets, write_cases
from benchmarks.speed.measure import Arm, Clock, Table, clock, interleaved, timing_rows
from benchmarks.speed.stages import Car, solvers, stages
from fgrecon.core.options import Options
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.solve.pipeline import reconstruct
from fgrecon.solve.scene import reconstruct_scene
from fgrecon_research.paper.icra2017 import import_icra2017, load_icra2017_example

PEERS = ("sqpnp_confident", "poselib_ransac", "aspnp")


def one_car(kind: str, cars: Sequence[Car], repeats: int) -> Table:
    """Every stage of one car, and solvers of the pose alone beside it."""
    peers = {f"pose alone: {name}": [car.baseline(name) for car in cars] for name in PEERS}
    table = Table(f"One car, 14 points, 5 vectors: {kind}")
    table.rows = timing_rows(interleaved({**stages(cars), **peers}, repeats))
    table.notes.append(f"{len(cars)} cars; keypoints of pose-alone solvers are the same.")
    return table


def one_minimisation(kind: str, cars: Sequence[Car], repeats: int) -> Table:
    """One joint solve by several solvers."""
    table = Table(f"One joint minimisation under fixed weights: {kind}")
    table.rows = timing_rows(interleaved(solvers(cars), repeats))
    table.notes.append(
        "scipy and Ceres have the energy in plain numpy with numeric derivatives: what analytic factors save, not what "
        "these solvers could do with a cost in C++."
    )
    return table


def large_cars(folder: Path) -> tuple[ShapePrior, list[Car]]:
    """The two photographs of the authors' release: 36 points, 42 vectors, and their first guess of the azimuth."""
    prior = import_icra2017(folder)
    examples = [load_icra2017_example(folder, name) for name in ("01", "02")]
    cases = [Case(example.observation, example.camera, prior="car36") for example in examples]
    guesses = [example.azimuth for example in examples]
    return prior, [Car.of(case, prior, guess) for case, guess in zip(cases, guesses, strict=True)]


def large(cars: Sequence[Car], repeats: int) -> Table:
    """Stages with 36 points and 42 vectors."""
    table = Table("One car, 36 points, 42 vectors: the two photographs of the authors' release")
    table.rows = timing_rows(interleaved(stages(cars), repeats))
    return table


def tracks(folder: Path, lengths: Sequence[int], repeats: int) -> Table:
    """Whether an image of a track costs the same however long the track is."""
    file = write_cases(folder / "drive.json", drive(max(lengths)))
    columns = ("images", "CPU ms an image", "proposals", "graph", "all / that of the shortest", "memory, MiB")
    table = Table("Tracks: one car in many images", columns)
    shortest = 0.0
    for length in lengths:
        answers = []
        for _ in range(repeats):
            with Arm(file) as arm:  # a process for each: the memory is the most that it ever had
                answers.append(arm.ask(track=list(range(length))))
        best = min(answers, key=lambda answer: answer["cpu"])
        each = best["cpu"] / length
        shortest = shortest or each
        share = {name: best["stages"][name] / sum(best["stages"].values()) for name in ("pose", "joint")}
        row = [each, each * share["pose"], each * share["joint"], each / shortest, best["memory"]]
        table.rows.append([str(length), *row])
    table.notes.append("Memory: the most that the process took during the track over what it had after one image.")
    return table


def scenes(counts: Sequence[int], images: int, repeats: int) -> Table:
    """Whether cars on one ground cost about what they cost one by one."""
    columns = ("cars in the image", "images", "CPU ms: median", "p95", "one by one: median", "in cars, median", "p95")
    table = Table("Scenes: cars of one image on one ground", columns)
    for count in counts:
        streets_ = streets(count, images)
        rows = {
            name: [_scene(street, together=name == "together") for street in streets_] for name in ("alone", "together")
        }
        for run in [run for calls in rows.values() for run in calls[:2]]:
            run()  # which warms every cache
        taken = {name: times.min(axis=1)[:, 0] for name, times in interleaved(rows, repeats).items()}
        p50, p95 = np.percentile(taken["together"], (50, 95))
        in_cars = np.percentile(count * taken["together"] / taken["alone"], (50, 95))
        table.rows.append([str(count), str(images), *map(float, (p50, p95, np.median(taken["alone"]), *in_cars))])
    table.notes.append(
        "In cars: CPU time of `reconstruct_scene` over that of `reconstruct` for one car, the mean of the image's."
    )
    return table


def _scene(street: Sequence[Case], *, together: bool) -> Clock:
    first, seen = street[0], [case.observation for case in street]
    settings = {"ground": first.ground, "size_prior": first.size, "prior": first.prior}
    options = Options(keep_history=False)
    if together:
        return clock(lambda: reconstruct_scene(seen, first.camera, options=options, **settings))
    return clock(lambda: [reconstruct(one, first.camera, options=options, **settings) for one in seen])


def equal(kinds: dict[str, Sequence[Car]]) -> Table:
    """How far results are from the minimum of the robust energy."""
    columns = ("", "cars", "metres: median", "worst", "degrees: median", "worst")
    table = Table("Results against the fully converged minimum", columns)
    for kind, cars in kinds.items():
        if cars:
            metres, degrees = np.array([car.from_the_minimum() for car in cars]).T
            values = map(float, (np.median(metres), metres.max(), np.median(degrees), degrees.max()))
            table.rows.append([kind, str(len(cars)), *values])
    table.notes.append(
        "The minimum is found from the result on by another solver, on the energy written out in plain numpy, without "
        "weights; visibility is held."
    )
    return table


def steady(folder: Path, cases: Sequence[Case], solves: int) -> tuple[Table, Table]:
    """Whether memory grows over many solves, and whether threads and processes find the same bits."""
    file = write_cases(folder / "steady.json", cases)
    memory = Table(f"Memory over {solves} solves", ("after solves", "resident, MiB", "growth since the first tenth"))
    with Arm(file) as arm:
        marks = {solves // 10, solves // 4, solves // 2, 3 * solves // 4, solves}
        first = 0.0
        for solve in range(1, solves + 1):
            arm.ask(solve=solve % len(cases))
            if solve in marks:
                now = arm.ask(memory=None)["memory"]
                first = first or now
                memory.rows.append([str(solve), now, now - first])
    bits = Table("Same bits", ("solved by", "cars", "same as one thread"))
    few = list(range(min(12, len(cases))))
    with Arm(file) as arm, Arm(file) as spawned, Arm(file, **NUMPY) as plain:
        found = arm.ask(bits=few)
        found["another process"] = [spawned.ask(solve=i)["digest"] for i in few]
        found["without the kernel"] = [plain.ask(solve=i)["digest"] for i in few]
    for name, digests in found.items():
        same = sum(a == b for a, b in zip(digests, found["one thread"], strict=True))
        bits.rows.append([name, str(len(few)), str(same)])
    bits.notes.append("Without the kernel, results may differ by rounding: see the differences between versions.")
    return memory, bits
