"""Processes that keep what they work with."""

import os
import signal
import subprocess
import sys
from functools import partial

import pytest

from fgrecon.core.processes import one_thread_each, processes, processes_with

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


def held_back():
    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])


def ignored():
    return signal.getsignal(signal.SIGINT) is signal.SIG_IGN


def test_interrupts_are_held_back_until_a_process_ignores_them():
    with processes(2, _expect_held_back) as pool:
        assert (pool.submit(held_back).result(), pool.submit(ignored).result()) == (False, True)
    assert not held_back()


def _expect_held_back():
    assert held_back()


def test_tasks_that_wait_are_left_out_when_the_body_ends(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        _interrupted(tmp_path)
    assert len(list(tmp_path.iterdir())) < 10


def _interrupted(folder):
    with processes(1) as pool:
        for number in range(50):
            pool.submit(_write, folder / str(number))
        raise KeyboardInterrupt


def _write(path):
    path.write_text("")


SCRIPT = """
import signal, time
from fgrecon.core.processes import processes
if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # where the tests run in the background it is ignored
    with processes(2) as pool:
        print("begun", flush=True)
        list(pool.map(time.sleep, [1.0] * 300))
"""


def test_ctrl_c_while_processes_begin_is_the_parents_alone(tmp_path):
    (tmp_path / "script.py").write_text(SCRIPT)
    running = subprocess.Popen(
        [sys.executable, str(tmp_path / "script.py")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert running.stdout.readline() == "begun\n"  # the parent has, its processes have not
    os.killpg(running.pid, signal.SIGINT)
    _, said = running.communicate(timeout=120)
    assert said.count("Traceback") == said.count("KeyboardInterrupt") == 1
