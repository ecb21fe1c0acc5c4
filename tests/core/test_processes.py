"""Processes that keep what they work with."""

import os
from functools import partial

import pytest

from fgrecon.core.processes import one_thread_each, processes_with

THREADS = "OMP_NUM_THREADS"


class Work:
    """Tells its process, how often it was called, its threads, and the task times a factor."""

    def __init__(self, factor):
        self.factor, self.calls = factor, 0

    def __call__(self, task):
        self.calls += 1
        return os.getpid(), self.calls, os.environ[THREADS], self.factor * task

    def __reduce__(self):
        raise AssertionError("it is made in the process, not sent there")


def test_a_process_makes_once_what_it_works_with(monkeypatch):
    monkeypatch.setenv(THREADS, "7")
    with processes_with(partial(Work, 3), 1) as (pool, run):
        found = list(pool.map(run, range(4)))
        (again,) = pool.map(run, [9])
    assert len({process for process, *_ in found}) == 1
    assert found[0][0] != os.getpid()
    assert [rest for _, *rest in found] == [[1, "1", 0], [2, "1", 3], [3, "1", 6], [4, "1", 9]]
    assert again[1:] == (5, "1", 27)
    assert os.environ[THREADS] == "7"


def test_threads_are_as_before(monkeypatch):
    monkeypatch.delenv(THREADS, raising=False)
    with one_thread_each():
        assert os.environ[THREADS] == "1"
    assert THREADS not in os.environ
    monkeypatch.setenv(THREADS, "3")
    with pytest.raises(ZeroDivisionError), one_thread_each():
        _ = 1 / 0
    assert os.environ[THREADS] == "3"
