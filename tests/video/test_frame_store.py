"""Frames of a run come back from their file as they were put there."""

import errno
import os
import pickle
import tempfile
import types
from dataclasses import replace

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.reconstruction import Status
from fgrecon.core.serialise import plain
from fgrecon.simulation import KITTI_CAMERA
from fgrecon.solve.tracker import Tracker
from fgrecon.video.follow import TrackedFrame
from fgrecon.video.frame_store import FrameStore
from fgrecon.video.rows import frame_lines, rows_of
from tests.video.streets import simulated


@pytest.fixture
def frames():
    """Three frames of two vehicles, the first of which is not in the second frame."""
    tracker, found = Tracker(), []
    for number, pair in enumerate(zip(*simulated(3), strict=True)):
        seen = {i: one for i, one in enumerate(pair) if not (number == 1 and i == 0)}
        estimates = tracker.update(0.1 * number, seen, camera=KITTI_CAMERA, ground=1.65)
        boxes, scores = {i: one.box for i, one in seen.items()}, dict.fromkeys(seen, 0.5)
        common = (number, 0.1 * number, f"{number}.png", None, np.eye(4))
        found.append(TrackedFrame(*common, boxes, scores, observations=seen, estimates=estimates))
    return found


def fields_of(frames):
    return (
        [*frame_lines(frames)],
        rows_of(frames),
        [one.reconstruction.to_dict() for f in frames for one in f.estimates.values()],
    )


def test_frames_come_back(frames, tmp_path):
    store = FrameStore(frames, folder=tmp_path)
    assert (len(store), [frame.number for frame in store]) == (3, [0, 1, 2])
    assert fields_of(store) == fields_of(frames)
    assert [frame.number for frame in store[1:]] == [1, 2]
    assert plain(store[1].observations[1].keypoints) == plain(frames[1].observations[1].keypoints)
    with pytest.raises(IndexError):
        store[3]
    assert not [*tmp_path.iterdir()]
    heads = [(head.time, head.identities, [*head.found]) for head in store.heads]
    assert heads == [(0.0, (0, 1), [0, 1]), (0.1, (1,), [1]), (0.2, (0, 1), [0, 1])]
    np.testing.assert_array_equal(store.heads[0].place, 0.0)


def test_an_estimate_is_replaced(frames):
    store = FrameStore(frames)
    other = replace(frames[0].estimates[0], time=frames[2].time, frames=17)
    for identity, one in ((0, other), (0, replace(other, time=7.0)), (7, other)):  # the last two are of no estimate
        store.put(identity, one)
    assert store[2].estimates[0].frames == store[-1].estimates[0].frames == 17
    assert [*store[2].estimates] == [0, 1]
    assert [frame.estimates[1].frames for frame in store] == [frame.estimates[1].frames for frame in frames]
    assert isinstance(store.heads[2].found[0], Status)


def test_what_is_not_looked_at_is_not_made_and_what_is_shared_is_kept_once(frames):
    store = FrameStore(frames)
    estimates = [frame.estimates[1].reconstruction for frame in store]
    assert [{*one.diagnostics.not_made} for one in estimates] == [{"sigmas", "visibility"}] * 3
    surface = [one.shape.not_made["surface_vertices"].func.__self__ for one in estimates]
    assert surface[0] is surface[1] is surface[2]
    assert os.fstat(store._file.fileno()).st_size < 20_000 * sum(len(frame.estimates) for frame in frames)
    assert len(pickle.dumps(estimates[0])) > 20_000


def test_a_full_disk_is_reported(frames):
    store = FrameStore()

    def full(content):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    store._file = types.SimpleNamespace(seek=lambda *_: 0, write=full)
    with pytest.raises(InvalidInputError, match="No space left on device"):
        store.append(frames[0])


def test_on_a_full_disk_the_end_of_a_store_is_silent(monkeypatch):
    def full():
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(tempfile, "TemporaryFile", lambda **_: types.SimpleNamespace(close=full))
    store = FrameStore()
    del store  # pytest makes an error of what a finalizer raises
