"""The same bits from one thread, eight threads and other processes; and many solves take no more memory than few."""

from __future__ import annotations

import gc
import hashlib
import multiprocessing
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from fgrecon.core.options import Options
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.pipeline import reconstruct
from tests.cars import CAMERA, observe, yaw_pose

CARS = 8
SHAPES = np.random.default_rng(0).normal(size=(CARS, 5))


def bits(number):
    """Digest of everything that a solve of a car with 3 px of noise finds."""
    prior = load_prior("car14")
    seen = observe(prior, yaw_pose(0.7 * number), SHAPES[number], noise=3.0, seed=number)
    result = reconstruct(seen, CAMERA, prior=prior, ground=1.65, options=Options(keep_history=False))
    arrays = (result.camera_T_object, result.shape.coefficients, result.wireframe, result.diagnostics.weights)
    return hashlib.sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)).hexdigest()


@pytest.fixture(scope="module")
def alone():
    found = [bits(number) for number in range(CARS)]
    assert len(set(found)) == CARS
    return found


def test_eight_threads_find_the_same_bits(alone):
    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(bits, [*range(CARS)] * 4)) == alone * 4


FORKS = """
import multiprocessing
from tests.solve.test_processes import CARS, bits

found = [bits(number) for number in range(CARS)]
with multiprocessing.get_context("fork").Pool(2) as pool:
    assert pool.map(bits, range(CARS)) == found
print(*found)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")
def test_forked_processes_find_the_same_bits(alone):
    """In a process of its own: the test run may have threads, beside which one should not fork."""
    done = subprocess.run([sys.executable, "-c", FORKS], capture_output=True, text=True, check=True, timeout=300)
    assert done.stdout.split() == alone


def test_spawned_processes_find_the_same_bits(alone):
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        assert pool.map(bits, range(CARS)) == alone


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="the system does not tell the resident memory")
def test_many_solves_take_no_more_memory_than_few(alone):
    for number in [*range(CARS)] * 3:
        bits(number)
    before = _resident()
    for number in [*range(CARS)] * 15:
        bits(number)
    assert _resident() - before < 4.0  # MiB for 120 solves; their results alone, if they stayed, would take 16


def _resident():
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20
