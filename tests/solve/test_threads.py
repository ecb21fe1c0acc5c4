"""The pools of BLAS and OpenMP are at one thread while a solve runs, and as they were when none does."""

import os
import subprocess
import sys
from threading import Barrier, Event, Thread

import numpy as np
import pytest
import scipy.linalg  # noqa: F401  # brings a BLAS beside numpy's
from threadpoolctl import ThreadpoolController

from factors import X, guarded_factor
from fgrecon.core.errors import InvalidInputError
from fgrecon.solve.pipeline import reconstruct
from fgrecon.solve.threads import single_threaded
from fgrecon.solve.track import reconstruct_track
from tests.cars import CAMERA

from .conftest import solve


def numbers():
    return {pool.filepath: pool.num_threads for pool in ThreadpoolController().lib_controllers}


@pytest.fixture
def before():
    """Two threads in every pool, also on a machine of one core or where the environment says one."""
    with ThreadpoolController().limit(limits=2):
        found = numbers()
        assert found
        assert set(found.values()) == {2}
        yield found


@pytest.fixture
def watched():
    """A factor without effect, and the numbers of threads that it found in the middle of solves."""
    found = []

    def watch(*_):
        found.append(set(numbers().values()))
        return np.zeros(1), np.zeros((1, 6))

    return found, guarded_factor("watch", 1.0, [X(0, 0)], [6], 1, watch)


def test_a_solve_holds_the_pools_at_one_thread_and_gives_them_back(before, watched, seen, prior):
    inside, factor = watched
    solve(seen[0], extra_factors=[factor])
    assert inside
    assert all(found == {1} for found in inside)
    assert numbers() == before


def test_so_does_a_track(before, watched, seen):
    inside, factor = watched
    reconstruct_track([seen[0]], CAMERA, extra_factors=[factor])
    assert inside
    assert all(found == {1} for found in inside)
    assert numbers() == before


def test_a_refusal_gives_them_back(before):
    with pytest.raises(InvalidInputError):
        reconstruct([[0.0, 0.0]], CAMERA)
    assert numbers() == before


def test_a_solve_within_a_solve_leaves_the_outer_one_alone(before):
    outer = single_threaded(lambda: (single_threaded(numbers)(), numbers()))
    assert [set(found.values()) for found in outer()] == [{1}, {1}]
    assert numbers() == before


def test_the_last_of_several_threads_gives_them_back(before):
    inside, first_may_end, first_has_ended = Barrier(2, timeout=30), Event(), Event()
    blas = {pool.filepath for pool in ThreadpoolController().select(user_api="blas").lib_controllers}
    found = []

    @single_threaded
    def first():
        inside.wait()
        first_may_end.wait(30)

    @single_threaded
    def second():
        inside.wait()
        first_may_end.set()
        first_has_ended.wait(30)
        found.append(numbers())

    threads = [Thread(target=first), Thread(target=second)]
    for thread in threads:
        thread.start()
    threads[0].join(30)
    first_has_ended.set()
    threads[1].join(30)
    assert {found[0][path] for path in blas} == {1}
    assert numbers() == before


def test_what_is_decorated_keeps_its_name_and_its_arguments():
    @single_threaded
    def add(left, right=2):
        """Sum."""
        return left + right

    assert (add.__name__, add.__doc__) == ("add", "Sum.")
    assert (add(1), add(1, right=4)) == (3, 5)


LATE = """
import numpy, sys
from threadpoolctl import ThreadpoolController
from fgrecon.solve.threads import single_threaded

def numbers():
    return sorted(pool.num_threads for pool in ThreadpoolController().lib_controllers)

with_numpy = len(numbers())
print(set(single_threaded(numbers)()), "scipy.linalg._flapack" in sys.modules)
import cv2
ThreadpoolController().limit(limits=2)
print(set(numbers()), set(single_threaded(numbers)()), set(numbers()))
"""


def test_libraries_that_come_late_are_held_too():
    assert _script(LATE) == "{1} True\n{2} {1} {2}\n"


FORK = """
import os, threading, warnings
from threadpoolctl import ThreadpoolController
from fgrecon.solve.threads import single_threaded

warnings.simplefilter("ignore")  # newer Pythons advise against forking beside threads: just that is meant here

def numbers():
    return {pool.num_threads for pool in ThreadpoolController().lib_controllers}

single_threaded(numbers)()
ThreadpoolController().limit(limits=2)
inside, end = threading.Event(), threading.Event()

@single_threaded
def held():
    inside.set()
    end.wait(30)

thread = threading.Thread(target=held)
thread.start()
inside.wait(30)
child = os.fork()
if child == 0:
    fine = numbers() == {2} and single_threaded(numbers)() == {1} and numbers() == {2}
    os._exit(0 if fine else 1)
print(os.waitpid(child, 0)[1], numbers())
end.set()
thread.join()
print(numbers())
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")
def test_a_child_forked_beside_a_solve_starts_afresh():
    assert _script(FORK) == "0 {1}\n{2}\n"


def _script(code):
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    assert done.stderr == ""
    return done.stdout
