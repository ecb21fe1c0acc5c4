"""What recording costs, beside the solve that is recorded: one car, several, and a track.

Run from the repository root, on one core:
    OMP_NUM_THREADS=1 python -m benchmarks.bench_recording
Simulated cars with the mistakes of a real network; medians. A recording is made in the caller's thread, and encoded
and written in others. CPU times are of both, since other work on the machine disturbs wall time; the wall time of
several cars is that of `--save`. `rerun alone` encodes and writes the chunks of a finished recording once more, ready
as they are, without a layout: the least that it takes. Recordings go to a temporary folder.
"""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import rerun as rr
from rerun.chunk import RrdReader

import fgrecon
from fgrecon.simulation.vehicles import KITTI_CAMERA, Vehicle, simulate_track
from fgrecon.solve.track import reconstruct_track
from fgrecon.viz import Recording, SolvedVehicle, TrackInputs, recording_of, track_recording_of
from fgrecon.viz.sinks import deliver
from fgrecon_research.simulation import simulate_many

CARS, FRAMES, ROUNDS = 30, 15, 3


def milliseconds(action: Callable[[], object], clock: Callable[[], float] = time.process_time) -> float:
    """Time of an action by a clock."""
    start = clock()
    action()
    return 1e3 * (clock() - start)


def cost(recording: Recording, path: Path) -> tuple[float, float]:
    """CPU time of writing a recording: until the caller's thread is free, and of all threads together."""
    threads = time.process_time()
    own = time.thread_time()
    finish = recording.begin(path)
    own = time.thread_time() - own
    finish()
    return 1e3 * own, 1e3 * (time.process_time() - threads)


def cars(folder: Path) -> None:
    """One car after the other."""
    prior, rows, walls = fgrecon.load_prior("car14"), [], []
    seen = [observation for observation, _ in simulate_many(prior, CARS, np.random.default_rng(0))]

    def solve(o: fgrecon.Observation, *, keep: bool) -> fgrecon.Reconstruction:
        given = {"confidence": o.confidence, "box": o.box, "prior": prior, "ground": 1.65}
        return fgrecon.reconstruct(o.keypoints, KITTI_CAMERA, options=fgrecon.Options(keep_history=keep), **given)

    first = solve(seen[0], keep=True)
    opening = milliseconds(lambda: recording_of(SolvedVehicle(first, seen[0], KITTI_CAMERA)).write(folder / "car.rrd"))
    for _ in range(ROUNDS):
        made = []
        for observation in seen:
            off = milliseconds(lambda o=observation: solve(o, keep=False))
            on = milliseconds(lambda o=observation: solve(o, keep=True))
            recording = recording_of(SolvedVehicle(solve(observation, keep=True), observation, KITTI_CAMERA))
            made.append((str(len(made)), recording))
            rows.append((off, on, *cost(recording, folder / "car.rrd"), again(folder / "car.rrd", folder)))
        solving = milliseconds(lambda: [solve(o, keep=False) for o in seen], time.perf_counter)
        save = folder / "cars.rrd"
        writing = milliseconds(
            lambda made=made, save=save: deliver(made, save, None, spawn=False, several=True), time.perf_counter
        )
        walls.append((solving / CARS, writing / CARS))
    off, on, own, threads, least = np.median(rows, axis=0)
    tell(f"one car, {len(first.diagnostics.history)} steps", off, on, own, threads)
    print(f"  rerun alone {least:.1f} ms ({least / off:.0%}); the first recording of a process {opening:.0f} ms")
    solving, writing = np.median(walls, axis=0)
    print(f"{CARS} cars, wall time each: solve {solving:.1f} ms, --save {writing:.1f} ms ({writing / solving:.0%})")


def again(path: Path, folder: Path) -> float:
    """CPU time of all threads that rerun takes to write the chunks of a recording once more."""
    chunks = list(RrdReader(path).stream())

    def write() -> None:
        stream = rr.RecordingStream("again")
        kept = stream.memory_recording()
        stream.send_chunks(chunks)
        (folder / "again.rrd").write_bytes(kept.drain_as_bytes())
        stream.disconnect()

    return milliseconds(write)


def tell(what: str, off: float, on: float, own: float, threads: float) -> None:
    """One line about the times of a solve without and with history, and of writing the recording."""
    history = f"history {on - off:+.1f} ms ({on / off - 1:+.0%})"
    file = f"{own:.1f} ms ({own / off:.0%}) in the caller's thread, {threads:.1f} ms ({threads / off:.0%}) in all"
    print(f"{what}: solve {off:.1f} ms; {history}; recording {file}")


def track(folder: Path) -> None:
    """One car in several images."""
    rng = np.random.default_rng(25)
    seen = [o for o, _ in simulate_track(Vehicle.sample(fgrecon.load_prior("car14"), rng), FRAMES, rng)]

    def solve(*, keep: bool) -> object:
        return reconstruct_track(seen, KITTI_CAMERA, ground=1.65, options=fgrecon.Options(keep_history=keep))

    result = reconstruct_track(seen, KITTI_CAMERA, ground=1.65)
    recording = track_recording_of(result, TrackInputs(seen, [KITTI_CAMERA] * len(seen)))
    recording.write(folder / "track.rrd")
    off, on = (float(np.median([milliseconds(lambda k=k: solve(keep=k)) for _ in range(5)])) for k in (False, True))
    own, threads = np.median([cost(recording, folder / "track.rrd") for _ in range(5)], axis=0)
    tell(f"track of {len(seen)} images", off, on, own, threads)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as name:
        cars(Path(name))
        track(Path(name))
