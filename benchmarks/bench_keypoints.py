"""How long the keypoint networks take per car: KNet alone, with its mirror image, and the whole cascade.

Run from the repository root:
    python -m benchmarks.bench_keypoints [--weights FILE] [--batch 8] [--threads 2] [--device cpu]
Times cropping, networks and decoding of cars in one KITTI-sized image of noise; best and median of many runs.
"""

from __future__ import annotations

import argparse
import platform
import time
from pathlib import Path

import numpy as np
import torch

from fgrecon.perception.keypoints import KeypointCascade

CONDITIONS = {
    "KNet": {"refine": False, "mirror": False},
    "KNet, both ways": {"refine": False, "mirror": True},
    "cascade (KNet both ways, refinement)": {"refine": True, "mirror": True},
}


def clock(detector: KeypointCascade, image: np.ndarray, boxes: np.ndarray, repeats: int) -> tuple[float, float]:
    """Best and median wall time of one batch, seconds."""
    detector(image, boxes)
    times = []
    for _ in range(repeats):
        started = time.perf_counter()
        detector(image, boxes)
        times.append(time.perf_counter() - started)
    return min(times), float(np.median(times))


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
    rng = np.random.default_rng(0)
    image = rng.integers(0, 255, (375, 1242, 3)).astype(np.uint8)
    low = np.column_stack([rng.uniform(0, 1000, arguments.batch), rng.uniform(150, 250, arguments.batch)])
    boxes = np.hstack([low, low + rng.uniform(40, 120, low.shape)])
    print(f"{arguments.batch} cars, {arguments.threads} threads, {arguments.device}, {platform.machine()}")
    for name, settings in CONDITIONS.items():
        detector = KeypointCascade(arguments.weights, device=arguments.device, **settings)
        best, median = (1e3 * seconds / arguments.batch for seconds in clock(detector, image, boxes, arguments.repeats))
        print(f"  {name:40s}{best:7.1f} ms per car (median {median:.1f}), {1e3 / best:6.0f} cars per second")


if __name__ == "__main__":
    main()
