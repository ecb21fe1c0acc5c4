"""The faults that `benchmarks.mutations` puts into the solver, and the tests that guard each place."""

from __future__ import annotations

from benchmarks.mutation import Mutation
from benchmarks.mutations_of_results import DISCARDED, WRONG_ANSWERS
from benchmarks.mutations_of_terms import DROPPED_TERMS, WRONG_SIGNS, WRONG_WEIGHTS

__all__ = ["MUTATIONS", "Mutation"]

MUTATIONS = (*DROPPED_TERMS, *WRONG_SIGNS, *DISCARDED, *WRONG_WEIGHTS, *WRONG_ANSWERS)
