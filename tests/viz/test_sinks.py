"""Where recordings go."""

import struct
import subprocess
import sys

import pytest

from fgrecon.viz import sinks
from tests.viz.made_up import record

_ACTIVATION = 3  # kind of the message that tells a viewer what to do with a layout


def activations(path):
    """(shown, default) of every layout in a recording."""
    content, at, found = path.read_bytes(), 12, []
    while at < len(content):
        kind, length = struct.unpack_from("<QQ", content, at)
        message, at = content[at + 16 : at + 16 + length], at + 16 + length
        if kind == 0:  # what follows is the table of contents
            break
        if kind == _ACTIVATION:
            found.append((b"\x10\x01" in message[-4:], b"\x18\x01" in message[-4:]))
    return found


def test_the_layout_is_shown_and_not_only_at_hand(example, tmp_path):
    """Browsers leave a layout that is only the default for one that they make up."""
    path = record(tmp_path / "car.rrd", example.reconstruction, example.observation, example.camera)
    assert activations(path) == [(True, True)]


def test_a_viewer_that_listens_is_made_to_show_the_layout(monkeypatch):
    import rerun as rr

    calls = []
    monkeypatch.setattr(sinks, "check_viewer", lambda address: ("127.0.0.1", 9876))
    monkeypatch.setattr(rr.RecordingStream, "connect_grpc", lambda self, url: calls.append(url))
    monkeypatch.setattr(rr.RecordingStream, "send_blueprint", lambda self, layout, **how: calls.append((layout, how)))
    sinks.connected("fgrecon: car", "127.0.0.1:9876", "layout")
    assert calls == ["rerun+http://127.0.0.1:9876/proxy", ("layout", {"make_active": True, "make_default": True})]


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
