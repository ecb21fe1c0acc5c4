"""What recording costs, beside the solve that is recorded: one car, and a track.

Run from the repository root, on one core:
    OMP_NUM_THREADS=1 python -m benchmarks.bench_recording
Simulated cars with the mistakes of a real network; medians of CPU time, since other work on the machine disturbs wall
time. Recordings go to a temporary folder.
"""

import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

import fgrecon
from fgrecon.simulate import KITTI_CAMERA, Vehicle, simulate_many, simulate_track
from fgrecon.track import reconstruct_track
from fgrecon.viz import TrackSight, record, record_track

CARS, FRAMES = 30, 15


def milliseconds(action: Callable[[], object]) -> float:
    """CPU time of an action."""
    start = time.process_time()
    action()
    return 1e3 * (time.process_time() - start)


def cars(folder: Path) -> None:
    """One car after the other."""
    prior, rows = fgrecon.load_prior("car14"), []
    seen = [observation for observation, _ in simulate_many(prior, CARS + 1, np.random.default_rng(0))]
    for observation in seen:
        given = {"confidence": observation.confidence, "box": observation.box, "prior": prior, "ground": 1.65}

        def solve(*, keep: bool, o: fgrecon.Observation = observation, given: dict = given) -> fgrecon.Reconstruction:
            return fgrecon.reconstruct(o.keypoints, KITTI_CAMERA, options=fgrecon.Options(keep_history=keep), **given)

        result = solve(keep=True)
        times = [milliseconds(partial(solve, keep=False)), milliseconds(partial(solve, keep=True))]
        times.append(milliseconds(partial(record, folder / "car.rrd", result, observation, KITTI_CAMERA)))
        rows.append((*times, len(result.history)))
    off, on, writing, steps = np.median(rows[1:], axis=0)  # the first fills caches
    tell(f"one car, {steps:.0f} steps", off, on, writing)


def tell(what: str, off: float, on: float, writing: float) -> None:
    """One line about the times of a solve without and with history, and of writing the recording."""
    history, file = f"history {on - off:+.1f} ms ({on / off - 1:+.0%})", f"{writing:.1f} ms ({writing / off:.0%})"
    print(f"{what}: solve {off:.1f} ms; {history}; writing the recording {file}")


def track(folder: Path) -> None:
    """One car in several images."""
    rng = np.random.default_rng(25)
    seen = [o for o, _ in simulate_track(Vehicle.sample(fgrecon.load_prior("car14"), rng), FRAMES, rng)]
    sight = TrackSight(seen, [KITTI_CAMERA] * len(seen))

    def solve(*, keep: bool) -> object:
        return reconstruct_track(seen, KITTI_CAMERA, ground=1.65, options=fgrecon.Options(keep_history=keep))

    result = reconstruct_track(seen, KITTI_CAMERA, ground=1.65)
    record_track(folder / "track.rrd", result, sight)
    off, on = (np.median([milliseconds(partial(solve, keep=keep)) for _ in range(5)]) for keep in (False, True))
    writing = np.median([milliseconds(lambda: record_track(folder / "track.rrd", result, sight)) for _ in range(5)])
    tell(f"track of {len(seen)} images", float(off), float(on), float(writing))


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as name:
        cars(Path(name))
        track(Path(name))
