"""Compiled parts of scipy without the packages around them: the same, in whatever order they are imported."""

import subprocess
import sys

import numpy as np
import scipy.linalg

from fgrecon.core.compiled import _compiled, lapack, pivots_of_qr

_ALONE = """
import sys
from fgrecon.core.compiled import assignment, lapack
assert lapack().__name__ == "scipy.linalg._flapack"
assert "scipy.linalg" not in sys.modules
import scipy.linalg
assert scipy.linalg.lapack.dgetrf is lapack().dgetrf
assert scipy.linalg.solve([[2.0]], [4.0]) == 2.0

assert assignment().__name__ == "scipy.optimize._lsap"
assert "scipy.optimize" not in sys.modules
import scipy.optimize
assert scipy.optimize.linear_sum_assignment is assignment().linear_sum_assignment
"""


def test_it_is_that_of_scipy_and_comes_alone():
    assert lapack().dtrtrs is scipy.linalg.lapack.dtrtrs
    subprocess.run([sys.executable, "-c", _ALONE], check=True)


def test_where_scipy_has_another_layout_its_packages_are_taken(monkeypatch):
    monkeypatch.setattr("fgrecon.core.compiled.EXTENSION_SUFFIXES", [])
    monkeypatch.delitem(sys.modules, "scipy.linalg")
    assert _compiled("scipy.linalg", "_flapack", "lapack").dgetrf is scipy.linalg.lapack.dgetrf
    assert _compiled("scipy.optimize", "_lsap", "").linear_sum_assignment([[1.0]])[0] == [0]


def test_pivots_are_those_of_scipys_qr():
    matrix = np.random.default_rng(0).normal(size=(30, 50)) * (np.arange(50) % 7 > 2)
    np.testing.assert_array_equal(pivots_of_qr(matrix), scipy.linalg.qr(matrix, mode="r", pivoting=True)[1])
