"""What a fault is that `benchmarks.mutations` puts into the solver, and the files and tests that faults name."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = [
    "ADJUST",
    "COVARIANCE",
    "FACING",
    "GRAPH",
    "OBSERVATION",
    "OPTIMISE",
    "PROPOSALS",
    "REPROJECTION",
    "RESULT",
    "SEARCH",
    "SOLVER",
    "TERMS",
    "TEST_ADJUST",
    "TEST_BASINS",
    "TEST_COVARIANCE",
    "TEST_DEFAULTS",
    "TEST_EXTRA",
    "TEST_FACING",
    "TEST_GRAPH",
    "TEST_OPTIMISE",
    "TEST_PIPELINE",
    "TEST_PROPOSALS",
    "TEST_RECOVERY",
    "TEST_REPROJECTION",
    "TEST_SEARCH",
    "TEST_STATUS",
    "TEST_TERMS",
    "TEST_TRACK",
    "TEST_VISIBILITY",
    "TEST_WEIGHTS",
    "TEST_WIDER",
    "VEHICLE",
    "VISIBILITY",
    "Mutation",
]


@dataclass(frozen=True)
class Mutation:
    """One fault.

    Attributes:
        name: Its name.
        what: What it does, in words.
        file: The file that it is put into.
        edits: Pairs of a text, which must be there exactly once, and the one that takes its place.
        tests: Test files or tests that are run against it.
        red: How many of them must fail.
    """

    name: str
    what: str
    file: str
    edits: tuple[tuple[str, str], ...]
    tests: tuple[str, ...]
    red: int = 1


SEARCH = "fgrecon/solve/proposals/search.py"
TERMS = "fgrecon/solve/proposals/terms.py"
PROPOSALS = "fgrecon/solve/proposals/pose_search.py"
GRAPH = "fgrecon/solve/graph/graph.py"
VEHICLE = "fgrecon/solve/graph/vehicle_part.py"
OBSERVATION = "fgrecon/solve/graph/observation_part.py"
OPTIMISE = "fgrecon/solve/graph/optimise.py"
ADJUST = "fgrecon/solve/graph/multi_start.py"
FACING = "fgrecon/solve/graph/mode_selection.py"
COVARIANCE = "fgrecon/solve/graph/covariance.py"
SOLVER = "fgrecon/solve/graph/solver.py"
REPROJECTION = "factors/reprojection.py"
RESULT = "fgrecon/solve/result.py"
VISIBILITY = "fgrecon/solve/vehicle/visibility.py"

TEST_SEARCH = "tests/solve/proposals/test_search.py"
TEST_TERMS = "tests/solve/proposals/test_terms.py"
TEST_PROPOSALS = "tests/solve/proposals/test_pose_search.py"
TEST_GRAPH = "tests/solve/graph/test_graph.py"
TEST_ADJUST = "tests/solve/graph/test_multi_start.py"
TEST_WEIGHTS = "tests/solve/graph/test_weights.py"
TEST_OPTIMISE = "tests/solve/graph/test_optimise.py"
TEST_BASINS = "tests/solve/graph/test_multi_start.py"
TEST_WIDER = "tests/solve/graph/test_restarts.py"
TEST_FACING = "tests/solve/graph/test_mode_selection.py"
TEST_COVARIANCE = "tests/solve/graph/test_covariance.py"
TEST_EXTRA = "tests/solve/test_extra_factors.py"
TEST_REPROJECTION = "tests/factors/test_reprojection.py"
TEST_TRACK = "tests/solve/test_track.py"
TEST_PIPELINE = "tests/solve/test_pipeline.py"
TEST_STATUS = "tests/solve/test_status.py"
TEST_RECOVERY = "tests/solve/test_recovery.py"
TEST_VISIBILITY = "tests/solve/vehicle/test_visibility.py"
TEST_DEFAULTS = "tests/core/test_defaults.py"
