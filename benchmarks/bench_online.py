"""What following costs in the long run: time and memory of two cars that never leave, frame after frame.

Run from the repository root:
    python -m benchmarks.bench_online [--frames 10000] [--plot FILE]
Two simulated cars go to and fro before a camera that stands; `fgrecon.Tracker` follows them with the settings of
`fgrecon run`: a shared ground, and a past of a thousand frames. Printed are CPU time a car and frame and resident
memory by stretches of the run; `--plot` draws them. Linux.
"""

from __future__ import annotations

import argparse
import platform
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import fgrecon
from fgrecon.core.arrays import Array
from fgrecon.core.geometry import box_around, yaw_rotation
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.simulation import KITTI_CAMERA

_HEIGHT, _RATE, _STRETCHES = 1.65, 10.0, 10
_NOISE = 0.02  # of a car's extent in the image
_DIRECTIONS = 36


def observed(prior: ShapePrior, frame: int, car: int, rng: np.random.Generator) -> fgrecon.Observation:
    """A car on its way to and fro, as a network sees it."""
    phase = frame / 200.0 + 2.0 * car
    rotation = yaw_rotation(np.array([0.6 * np.sin(phase) + 1.2 * car]))[0]
    place = np.array([-3.0 + 6.0 * car, _HEIGHT, 20.0 + 8.0 * np.sin(0.7 * phase)])
    pixels = KITTI_CAMERA.project(prior.mean @ rotation.T + place)
    box = box_around(pixels)
    noisy = pixels + _NOISE * float((box[2:] - box[:2]).max()) * rng.normal(size=pixels.shape)
    x, _, z = -rotation.T @ place
    turn = 2.0 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS - np.arctan2(z, x)
    likely = np.exp((np.cos(turn) - 1.0) / 0.1) + 0.02
    return fgrecon.Observation(noisy, np.full(len(noisy), 0.8), box, azimuth=likely / likely.sum())


def resident() -> float:
    """Memory of this process, MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6


def run(frames: int) -> tuple[Array, Array]:
    """CPU time a car and frame in milliseconds, and memory in MB, of each frame (N,)."""
    prior, rng = fgrecon.load_prior("car14"), np.random.default_rng(0)
    tracker = fgrecon.Tracker(prior=prior, size_prior="kitti", shared_ground=True)
    times, memory = np.zeros(frames), np.zeros(frames)
    for frame in range(frames):
        seen = {car: observed(prior, frame, car, rng) for car in range(2)}
        started = time.process_time()
        found = tracker.update(frame / _RATE, seen, camera=KITTI_CAMERA, ground=_HEIGHT)
        times[frame] = (time.process_time() - started) / len(seen) * 1e3
        memory[frame] = resident()
        assert len(found) == len(seen), f"frame {frame}: {tracker.refused}"
    return times, memory


def table(times: Array, memory: Array) -> list[str]:
    """A line for each stretch of the run."""
    lines = ["| frames | CPU ms a car and frame: median | 95 % | memory MB |", "| --- | ---: | ---: | ---: |"]
    for some in np.array_split(np.arange(len(times)), _STRETCHES):
        middle, high = np.percentile(times[some], [50, 95])
        lines.append(f"| {some[0]} to {some[-1]} | {middle:.1f} | {high:.1f} | {memory[some[-1]]:.0f} |")
    return lines


def plot(times: Array, memory: Array, path: Path) -> None:
    """Both over the frames, times as medians of a hundred."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context({"svg.hashsalt": "fgrecon", "svg.fonttype": "none"}):
        figure = Figure(figsize=(9.0, 3.0), layout="constrained")
        above, beside = figure.subplots(1, 2)
        starts = np.arange(0, len(times), 100)
        medians = [float(np.median(times[start : start + 100])) for start in starts]
        _draw(above, starts, medians, "CPU ms a car and frame", "#1f77b4")
        _draw(beside, starts, memory[starts], "memory, MB", "#ff7f0e")
        figure.savefig(path, metadata={"Date": None})


def _draw(axes: Any, frames: Array, values: Sequence[float] | Array, name: str, colour: str) -> None:
    axes.plot(frames, values, color=colour)
    axes.set(xlabel="frame", ylabel=name, ylim=(0.0, 1.3 * max(values)))


def main() -> None:
    """Follow, print, draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=10_000)
    parser.add_argument("--plot", type=Path, help="SVG file")
    given = parser.parse_args()
    print(f"{platform.machine()}, Python {platform.python_version()}, {given.frames} frames of two cars")
    times, memory = run(given.frames)
    print("\n".join(table(times, memory)))
    if given.plot is not None:
        plot(times, memory, given.plot)


if __name__ == "__main__":
    main()
