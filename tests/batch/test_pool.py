"""Processes that die take nothing along but the piece that kills them."""

from __future__ import annotations

import os
import signal
from functools import partial

import pytest

from fgrecon.batch.pool import WorkerDiedError, work


def negate(marks, piece):
    """Minus each number; 13 kills always, 7 once, 5 raises."""
    for number in piece:
        mark = marks / str(number)
        if number == 13 or (number == 7 and not mark.exists()):
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        if number == 5:
            raise KeyError(number)
    return [-number for number in piece]


def who(piece):
    return [(os.environ["OMP_NUM_THREADS"], os.getpid())] * len(piece)


def blocked_while_sent():
    """Whether Ctrl-C is held back in this process now, as a function of any piece."""
    return partial(always, signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, []))


def always(answer, piece):
    ignored = signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    return [(answer, ignored, signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, []))] * len(piece)


class Interruptible:
    """Looks whether Ctrl-C would end a worker while it is sent to it."""

    def __reduce__(self):
        return blocked_while_sent, ()

    def __call__(self, piece):
        raise AssertionError


class Stillborn:
    """Cannot be sent to a worker whole."""

    def __reduce__(self):
        return os._exit, (3,)

    def __call__(self, piece):
        raise AssertionError


def single(piece):
    return [[number] for number in piece]


def lost(piece, error):
    assert isinstance(error, WorkerDiedError)
    return [f"lost {number}" for number in piece]


def all_of(function, pieces, jobs=2):
    return [value for result in work(function, pieces, jobs, single, lost) for value in result]


def test_every_piece_once_and_one_thread_each():
    found = all_of(who, [[i] for i in range(6)])
    assert [threads for threads, _ in found] == ["1"] * 6
    assert {pid for _, pid in found} - {os.getpid()}


def test_a_death_costs_nothing_but_the_piece_that_kills_again(tmp_path):
    pieces = [[1, 2], [7, 8], [3, 13, 4], [9, 10], [11]]
    found = all_of(partial(negate, tmp_path), pieces)
    assert sorted(map(str, found)) == sorted(map(str, [-1, -2, -7, -8, -3, -4, -9, -10, -11, "lost 13"]))


def test_what_the_function_raises_comes_out(tmp_path):
    with pytest.raises(KeyError):
        all_of(partial(negate, tmp_path), [[5]], jobs=1)


def test_pieces_are_taken_as_workers_are_free(tmp_path):
    taken = []

    def pieces():
        for number in range(20, 40):
            taken.append(number)
            yield [number]

    results = work(partial(negate, tmp_path), pieces(), 2, single, lost)
    next(results)
    assert len(taken) <= 4
    results.close()


def test_workers_that_cannot_begin_end_the_work():
    with pytest.raises(WorkerDiedError, match="before they have begun"):
        all_of(Stillborn(), [[1]], jobs=1)


def test_an_interrupt_is_not_for_workers_from_their_start_on():
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [])
    assert all_of(Interruptible(), [[1]], jobs=1) == [(True, True, False)]
    assert signal.pthread_sigmask(signal.SIG_BLOCK, []) == before
