"""Live input: the newest item is next, what it overtakes is left out, and nothing is left of the thread."""

import threading
import time

import numpy as np
import pytest
from typer.testing import CliRunner

from fgrecon.cli import main
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.source_frames import SourceFrame
from fgrecon.video.newest import LEFT_OUT, LiveFrames, Newest


class Camera:
    """Items that come when the test says so; it goes on when whoever takes them has them."""

    def __init__(self):
        self.shown, self.wanted, self.closed = [], threading.Semaphore(0), False
        self.end, self.error = threading.Event(), None

    def __iter__(self):
        try:
            while self.wanted.acquire() and not self.end.is_set():
                yield self.shown.pop(0)
            if self.error is not None:
                raise self.error
        finally:
            self.closed = True

    def show(self, newest, *items):
        """Let items come, and wait until the last one is there."""
        for item in items:
            self.shown.append(item)
            self.wanted.release()
            until(lambda item=item: newest._there is not None and newest._there[1] == item)

    def stop(self, error=None):
        self.error = error
        self.end.set()
        self.wanted.release()


def until(there):
    deadline = time.monotonic() + 20.0
    while not there():
        assert time.monotonic() < deadline
        time.sleep(0.001)


def threads():
    return [thread for thread in threading.enumerate() if thread.name == "fgrecon newest"]


@pytest.mark.parametrize("kept", [False, True])
def test_the_newest_is_next(kept):
    camera = Camera()
    newest = Newest(camera, leave_out=(lambda item: -item) if kept else None)
    taken, found = iter(newest), []
    camera.shown.append(1)
    camera.wanted.release()
    found.append(next(taken))
    camera.show(newest, 2, 3, 4)
    found += [next(taken) for _ in range(3 if kept else 1)]
    camera.show(newest, 5)
    camera.stop()
    until(lambda: camera.closed)
    assert [*found, *taken] == ([1, -2, -3, 4, 5] if kept else [1, 4, 5])
    assert (newest.left_out, len(newest.delays)) == (2, 3)
    assert not threads()


def test_what_would_be_late_is_left_out_for_what_comes_just_now():
    camera = Camera()
    newest = Newest(camera, max_delay=0.05)
    taken = iter(newest)
    camera.shown.append("slow")
    camera.wanted.release()
    assert next(taken) == "slow"
    time.sleep(0.06)  # more than may be: whatever is there when it is done would be late as well
    camera.show(newest, "late")
    threading.Timer(0.05, lambda: (camera.shown.append("fresh"), camera.wanted.release())).start()
    assert next(taken) == "fresh"
    assert newest.left_out == 1
    assert newest.delays[0] >= 0.06
    taken.close()
    camera.stop()
    until(lambda: not threads())


def test_an_error_of_the_camera_comes_after_its_items():
    camera = Camera()
    newest = Newest(camera)
    taken = iter(newest)
    camera.shown.append(1)
    camera.wanted.release()
    assert next(taken) == 1
    camera.show(newest, 2)
    camera.stop(ZeroDivisionError("cable"))
    until(lambda: camera.closed)
    assert next(taken) == 2
    with pytest.raises(ZeroDivisionError, match="cable"):
        next(taken)
    assert not threads()


@pytest.mark.parametrize("wrong", [0.0, -1.0, np.nan, np.inf, "soon"])
def test_a_delay_is_positive(wrong):
    with pytest.raises(InvalidInputError, match="max_delay"):
        Newest([], max_delay=wrong)


def frames(count, closed):
    try:
        for number in range(count):
            yield SourceFrame(number, 5.0 + 0.02 * number, f"{number}.png", np.zeros((2, 2, 3), np.uint8))
    finally:
        closed.append(True)


def test_frames_come_when_they_are_due_and_others_are_gaps():
    closed, live, found = [], LiveFrames(10.0), []
    for frame in live(frames(12, closed)):
        found.append(frame)
        if len(found) == 1:
            begun = time.monotonic()
        if frame.image is not None:
            time.sleep(0.05)
    assert [frame.number for frame in found] == [*range(12)]
    gaps = [frame for frame in found if frame.image is None]
    assert 3 <= len(gaps) < 11
    assert all(frame.left_out and frame.problem == f"{frame.name}: {LEFT_OUT}" for frame in gaps)
    assert len(live.delays) == 11 - len(gaps)
    assert time.monotonic() - begun >= 0.22  # the last one is due so long after the first
    assert closed == [True]
    assert [*LiveFrames(1.0)(frames(0, []))] == []


def test_frames_end_where_nobody_wants_more():
    closed = []
    some = LiveFrames(10.0)(frames(100, closed))
    assert [next(some).number for _ in range(2)] == [0, 1]
    some.close()
    until(lambda: closed == [True])
    until(lambda: not threads())


def test_smoothed_estimates_are_not_live(tmp_path):
    wanted = ["run", str(tmp_path), "--out", str(tmp_path / "out"), "--max-delay", "0.2"]
    done = CliRunner().invoke(main.app, wanted)
    assert isinstance(done.exception, InvalidInputError)
    assert "--online" in str(done.exception)
