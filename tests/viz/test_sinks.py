"""Where recordings go."""

import subprocess
import sys

import pytest


@pytest.mark.skipif(sys.platform == "win32", reason="limits the size of files as Unix does")
def test_a_full_disk_is_an_error_and_leaves_nothing(tmp_path):
    program = """
import resource, signal, sys
import numpy as np, rerun as rr, rerun.blueprint as rrb
from fgrecon.core.errors import InvalidInputError
from fgrecon.viz import sinks

signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
numbers = np.random.default_rng(0).random((100, 100))
send = lambda stream: [stream.log(f"n{i}", rr.Tensor(numbers)) for i in range(50)]
recording = sinks.Recording(lambda: send, rrb.Blueprint)
try:
    recording.write(sys.argv[1])
except InvalidInputError as error:
    print(error, flush=True)
"""
    path = tmp_path / "full.rrd"
    run = subprocess.run(  # the limit holds for a whole process
        [sys.executable, "-c", program, str(path)], capture_output=True, text=True, timeout=120, check=True
    )
    assert "full.rrd" in run.stdout
    assert list(tmp_path.iterdir()) == []
