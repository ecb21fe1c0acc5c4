"""`benchmarks.bench_online`: a short run of it."""

import sys

import pytest

from benchmarks.bench_online import plot, run, table

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")


def test_a_short_run_has_every_frame(tmp_path):
    times, memory = run(12)
    assert len(times) == len(memory) == 12
    assert (times > 0.0).all()
    assert (memory > 10.0).all()
    lines = table(times, memory)
    assert len(lines) == 12
    assert lines[-1].startswith("| 11 to 11 |")
    plot(times, memory, tmp_path / "online.svg")
    assert "CPU ms a car and frame" in (tmp_path / "online.svg").read_text()
