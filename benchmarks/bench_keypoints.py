"""How long the networks take: keypoints per car, cars' boxes per image, on every runtime that is installed.

Run from the repository root:
    python -m benchmarks.bench_keypoints [--weights FILE] [--batch 8] [--threads 2] [--device cpu] [--repeats 20]
Times cropping, networks and decoding of cars in one KITTI-sized image of smooth noise, and the detector's two passes at
it. Runtimes take turns, so that what else the machine does slows all of them: the ratio is that of their medians, above
one where the second is faster. Threads that wait for others lose most on a busy machine: see one thread as well.
"""

from __future__ import annotations

import argparse
import platform
import time
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
import torch

from fgrecon.perception.keypoints import KeypointCascade
from fgrecon.perception.vehicles import NanodetVehicleDetector

CONDITIONS = {
    "KNet": {"refine": False, "mirror": False},
    "KNet, both ways": {"refine": False, "mirror": True},
    "cascade (KNet both ways, refinement)": {"refine": True, "mirror": True},
}


def take_turns(runs: Mapping[str, Callable[[], object]], repeats: int) -> dict[str, np.ndarray]:
    """Wall times of each in seconds, in turns."""
    for run in runs.values():
        run()
    times: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(repeats):
        for name, run in runs.items():
            started = time.perf_counter()
            run()
            times[name].append(time.perf_counter() - started)
    return {name: np.array(seconds) for name, seconds in times.items()}


def row(title: str, times: Mapping[str, np.ndarray], share: int = 1) -> str:
    """Best and median of every runtime in milliseconds per part of a run, and how much faster the second is."""
    cells = [f"{name} {1e3 * t.min() / share:6.1f} ({1e3 * np.median(t) / share:.1f})" for name, t in times.items()]
    medians = [float(np.median(seconds)) for seconds in times.values()]
    ratio = f"  ratio {medians[0] / medians[1]:.2f}" if len(medians) > 1 else ""
    return f"  {title:52s}" + "  ".join(cells) + ratio


def main() -> None:
    """Time every condition."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--weights", type=Path)
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--repeats", type=int, default=20)
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    cv2.setNumThreads(arguments.threads)
    rng = np.random.default_rng(0)
    image = cv2.GaussianBlur(rng.integers(0, 255, (375, 1242, 3)).astype(np.uint8), (0, 0), 3.0)
    low = np.column_stack([rng.uniform(0, 1000, arguments.batch), rng.uniform(150, 250, arguments.batch)])
    boxes = np.hstack([low, low + rng.uniform(40, 120, low.shape)])
    onnx = ["onnx"] if all(find_spec(name) for name in ("onnx", "onnxruntime")) and arguments.device == "cpu" else []
    print(f"{arguments.threads} threads, {arguments.device}, {platform.machine()}; best (median) in ms")
    for count in sorted({1, arguments.batch}):
        for name, settings in CONDITIONS.items():
            runs = {}
            for runtime in ("torch", *onnx):
                cascade = KeypointCascade(arguments.weights, device=arguments.device, runtime=runtime, **settings)
                runs[runtime] = lambda cascade=cascade, some=boxes[:count]: cascade(image, some)
            print(row(f"{name}, per car of {count}", take_turns(runs, arguments.repeats), count), flush=True)
    detector = NanodetVehicleDetector()
    print(row("car detector, per image", take_turns({"onnx": lambda: detector(image)}, arguments.repeats)))


if __name__ == "__main__":
    main()
