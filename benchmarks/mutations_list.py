"""The faults that `benchmarks.mutations` puts into the solver, and the tests that guard each place."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["MUTATIONS", "Mutation"]


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
PROPOSALS = "fgrecon/solve/proposals/adjust.py"
GRAPH = "fgrecon/solve/graph/graph.py"
ADJUST = "fgrecon/solve/graph/adjust.py"
STATE = "fgrecon/solve/graph/state.py"
TRACK = "fgrecon/solve/track.py"
PIPELINE = "fgrecon/solve/pipeline.py"
RESULT = "fgrecon/solve/result.py"
VISIBILITY = "fgrecon/solve/vehicle/visibility.py"

TEST_SEARCH = "tests/solve/proposals/test_search.py"
TEST_TERMS = "tests/solve/proposals/test_terms.py"
TEST_PROPOSALS = "tests/solve/proposals/test_adjust.py"
TEST_GRAPH = "tests/solve/graph/test_graph.py"
TEST_ADJUST = "tests/solve/graph/test_adjust.py"
TEST_WEIGHTS = "tests/solve/graph/test_weights.py"
TEST_TRACK = "tests/solve/test_track.py"
TEST_PIPELINE = "tests/solve/test_pipeline.py"
TEST_STATUS = "tests/solve/test_status.py"
TEST_RECOVERY = "tests/solve/test_recovery.py"
TEST_VISIBILITY = "tests/solve/vehicle/test_visibility.py"
TEST_DEFAULTS = "tests/core/test_defaults.py"


EVERY_TERM = TEST_SEARCH + "::test_the_search_minimises_every_term"


def _dropped_from_the_search(term: str, line: str) -> Mutation:
    what = f"the search minimises without the term of the {term}"
    return Mutation(f"search-without-{term}", what, SEARCH, ((line, "            pass\n"),), (EVERY_TERM,))


def _dropped_from_the_graph(term: str, line: str, left: str = "pass") -> Mutation:
    indent = line[: len(line) - len(line.lstrip())]
    what = f"the graph has no factor for the {term}"
    return Mutation(f"graph-without-{term}", what, GRAPH, ((line, f"{indent}{left}\n"),), (TEST_GRAPH,))


DROPPED_TERMS = (
    _dropped_from_the_search("box", "            self.box.add(total, h)\n"),
    _dropped_from_the_search("size", "            self.size.add(total, h)\n"),
    _dropped_from_the_search("ground", "            self.ground.add(total, h)\n"),
    Mutation(
        "search-without-coefficients",
        "the search minimises without the prior on lambda",
        SEARCH,
        (("        coefficient_term(total, h)\n        return total, weights\n", "        return total, weights\n"),),
        (EVERY_TERM,),
    ),
    _dropped_from_the_graph("laplacian", '            terms["laplacian"] = [factor]\n'),
    _dropped_from_the_graph(
        "planarity", '        terms["planarity"] = self._planarity(category)\n', 'terms["planarity"] = []'
    ),
    _dropped_from_the_graph(
        "coefficients",
        '            terms["coefficients"] = [factors.'
        "coefficients_prior(self.shape.coefficients_key, prior.dimension)]\n",
    ),
    _dropped_from_the_graph(
        "offsets", '            terms["offsets"] = [factors.offsets_prior(self.shape.offsets_key, spread)]\n'
    ),
    _dropped_from_the_graph(
        "ground", '            terms["ground"] = self._ground_factors(self.pose_key, self.problem.ground)\n'
    ),
    _dropped_from_the_graph("box", '                terms["box"] = [factor]\n'),
)

WRONG_SIGNS = (
    Mutation(
        "residual-sign",
        "a keypoint's residual points the other way than its Jacobian",
        "factors/reprojection.py",
        (("return projection.pixels[i] - self.pixel,", "return self.pixel - projection.pixels[i],"),),
        ("tests/factors/test_reprojection.py",),
    ),
    Mutation(
        "rotation-jacobian-sign",
        "the derivative of the projection by the rotation is turned around",
        "factors/kernel.py",
        (("_NEGATIVE_SKEW = -np.cross(", "_NEGATIVE_SKEW = np.cross("),),
        ("tests/factors/test_kernel.py", "tests/factors/test_reprojection.py"),
    ),
    Mutation(
        "upright-jacobian-sign",
        "the derivative of the vehicle's lean is turned around",
        "factors/ground.py",
        (("_NEGATIVE_SKEW_Y = -np.array(", "_NEGATIVE_SKEW_Y = np.array("),),
        ("tests/factors/test_ground.py",),
    ),
    Mutation(
        "laplacian-constant-weights",
        "the Jacobian of the Laplacian takes its weights for constants",
        "factors/laplacian.py",
        (("moved = 2.0 * weights[", "moved = 0.0 * weights["),),
        ("tests/factors/test_laplacian.py",),
    ),
    Mutation(
        "no-barrier",
        "points behind the camera cost nothing",
        "factors/cheirality.py",
        (("np.full(1, np.inf)", "np.zeros(1)"),),
        ("tests/factors/test_cheirality.py",),
    ),
    Mutation(
        "search-ground-sign",
        "the search turns a leaning car further over",
        TERMS,
        (("-h.rotation[..., 0] / ground.tilt_sigma", "h.rotation[..., 0] / ground.tilt_sigma"),),
        (TEST_TERMS,),
    ),
    Mutation(
        "visibility-sign",
        "keypoints far behind the surface are visible, those before it hidden",
        VISIBILITY,
        (
            (
                "np.minimum((clearance - _MIDDLE) / _SOFTNESS, 500.0)",
                "np.minimum((_MIDDLE - clearance) / _SOFTNESS, 500.0)",
            ),
        ),
        (TEST_VISIBILITY,),
    ),
    Mutation(
        "visibility-mirrored",
        "visibility is looked up for the other side of the vehicle",
        VISIBILITY,
        (("np.arctan2(z, x) % (2.0 * np.pi)", "np.arctan2(-z, x) % (2.0 * np.pi)"),),
        (TEST_VISIBILITY,),
    ),
)

DISCARDED = (
    Mutation(
        "solutions-thrown-away",
        "every result of GTSAM is replaced by its start",
        "fgrecon/solve/graph/solver.py",
        (
            ("    return Solution(values, tuple(path), error,", "    return Solution(gtsam.Values(start), (), error,"),
            ("    converged = decrease <=", "    converged = True or decrease <="),
        ),
        (TEST_RECOVERY, TEST_PIPELINE, TEST_TRACK),
        red=5,
    ),
    Mutation(
        "never-unfinished",
        "a solve that is stopped short of its minimum counts as converged",
        "fgrecon/solve/graph/solver.py",
        (("converged = decrease <= max(relative_tolerance * error, _NEGLIGIBLE)", "converged = True"),),
        ("tests/solve/graph/test_solver.py",),
    ),
    Mutation(
        "joint-pose-thrown-away",
        "the pose of the joint stage is not taken over",
        ADJUST,
        (
            (
                "        state.pose, state.coefficients, state.offsets = graph.read(values)\n",
                "        _, state.coefficients, state.offsets = graph.read(values)\n",
            ),
        ),
        (TEST_RECOVERY,),
    ),
    Mutation(
        "track-solutions-thrown-away",
        "every solution of a track is replaced by its start",
        TRACK,
        (("            values = solution.values\n", ""),),
        (TEST_TRACK,),
        red=2,
    ),
    Mutation(
        "graph-weights-never-updated",
        "the graph keeps the weights of the pose search",
        STATE,
        (("    state.weights = strategy.weights(", "    strategy.weights("),),
        (TEST_WEIGHTS,),
    ),
    Mutation(
        "graph-anneals-not",
        "graduated non-convexity is at its end from the first update on",
        ADJUST,
        (("graph, values, update / max(updates - 1, 1))", "graph, values, 1.0)"),),
        (TEST_ADJUST + "::test_every_update_starts_where_the_last_one_ended_and_goes_down",),
    ),
    Mutation(
        "one-update-only",
        "the weights are updated once, however many updates are asked for",
        ADJUST,
        (("updates = max(problem.options.strategy.updates, 1)", "updates = 1"),),
        (TEST_WEIGHTS,),
    ),
    Mutation(
        "visibility-never-updated",
        "the graph keeps the visibility of the pose search",
        STATE,
        (("    state.visibility = energy.visibility(state.pose.matrix()[None])[0]\n", ""),),
        (TEST_ADJUST + "::test_every_update_starts_where_the_last_one_ended_and_goes_down",),
    ),
    Mutation(
        "algorithm1-weights-never-updated",
        "Algorithm 1 keeps the weights of Eq. 4",
        "fgrecon/solve/proposals/irls.py",
        (("        weights = term.strategy.weights(squared,", "        term.strategy.weights(squared,"),),
        ("tests/solve/proposals/test_irls.py",),
    ),
    Mutation(
        "box-weights-all-one",
        "a wrong edge of the 2D box counts as a right one",
        STATE,
        (("energy.box.weights(energy.box.residuals(_hypothesis(graph, values)))[0]", "np.ones(4)"),),
        (TEST_WEIGHTS,),
    ),
)

WRONG_WEIGHTS = (
    Mutation(
        "search-weights-without-root",
        "the search weighs residuals by w, not by its root",
        TERMS,
        (("        scale = np.sqrt(weights)\n        by_camera", "        scale = weights\n        by_camera"),),
        (TEST_TERMS,),
    ),
    Mutation(
        "graph-weights-squared",
        "a keypoint's covariance is divided by the square of its weight",
        "factors/noise.py",
        (("Covariance(matrix / weight)", "Covariance(matrix / weight**2)"),),
        ("tests/factors/test_noise.py", TEST_GRAPH),
    ),
    Mutation(
        "graph-box-weights-unused",
        "the graph's box factor does not use the weights of the edges",
        GRAPH,
        (("box.sigma / np.sqrt(box_weights[used])", "np.full(used.sum(), box.sigma)"),),
        (TEST_GRAPH,),
    ),
    Mutation(
        "missed-default",
        "missed = 0.6: an unsure detector says little about what is visible",
        "fgrecon/core/robust.py",
        (("missed: float = number(0.2,", "missed: float = number(0.6,"),),
        (TEST_DEFAULTS, TEST_RECOVERY),
        red=3,
    ),
    Mutation(
        "keypoint-sigma-default",
        "keypoints are taken for half as exact",
        "fgrecon/core/options.py",
        (("sigma_relative: float = number(0.035,", "sigma_relative: float = number(0.07,"),),
        (TEST_DEFAULTS, TEST_RECOVERY),
        red=3,
    ),
    Mutation(
        "midpoint-ignored",
        "every confidence is read as if even chances were at 0.2",
        "fgrecon/core/observation.py",
        (("squared / (squared + self.confidence_midpoint**2)", "squared / (squared + 0.2**2)"),),
        ("tests/core/test_observation.py", TEST_PIPELINE + "::test_a_confidence_means_what_its_observation_says"),
    ),
)

WRONG_ANSWERS = (
    Mutation(
        "aspnp-starts-dropped",
        "the search does not start from the minima of ASPnP",
        PROPOSALS,
        (("    parts.append(_from_aspnp(problem))\n", ""),),
        (TEST_PROPOSALS,),
    ),
    Mutation(
        "aspnp-unweighted",
        "ASPnP trusts every keypoint alike",
        PROPOSALS,
        (("found = aspnp(prior.mean[used], rays, weights[used])", "found = aspnp(prior.mean[used], rays)"),),
        (TEST_PROPOSALS,),
    ),
    Mutation(
        "3d-box-start-dropped",
        "the search does not start from a given 3D box",
        PROPOSALS,
        (("        parts.append(from_box3d(initial, model, ground))\n", "        pass\n"),),
        (TEST_PROPOSALS,),
    ),
    Mutation(
        "alternatives-dropped",
        "other poses that explain the keypoints are kept to oneself",
        PROPOSALS,
        (("for i in distinct[1:]", "for i in distinct[:0]"),),
        (TEST_PROPOSALS,),
    ),
    Mutation(
        "covariance-swapped",
        "the pose's covariance has translation before rotation",
        "fgrecon/solve/graph/covariance.py",
        (
            (
                "pose = marginals.marginalCovariance(vehicle.pose_key)",
                "pose = np.roll(marginals.marginalCovariance(vehicle.pose_key), 3, (0, 1))",
            ),
        ),
        ("tests/solve/graph/test_covariance.py",),
    ),
    Mutation(
        "covariance-weighs-twice",
        "the covariance counts the m-estimator's weight in the noise and in the loss",
        PIPELINE,
        (("weights = graph_weights(problem.energy, shape.weights, shape.visibility)", "weights = shape.weights"),),
        ("tests/solve/graph/test_covariance.py",),
    ),
    Mutation(
        "ambiguity-margin-ignored",
        "another pose makes a result ambiguous within 3 nats, whatever the options say",
        RESULT,
        (("if a.excess <= options.ambiguity_margin", "if a.excess <= 3.0"),),
        (TEST_STATUS,),
    ),
    Mutation(
        "visibility-from-behind",
        "the result tells what a camera on the other side would see",
        RESULT,
        (("centre = -camera_T_object", "centre = camera_T_object"),),
        (TEST_PIPELINE + "::test_the_parts_of_a_result_fit_together",),
    ),
    Mutation(
        "box-distortion-ignored",
        "the 2D box is not freed of lens distortion",
        PIPELINE,
        (("camera.undistort(seen.box.reshape(2, 2)).ravel()", "seen.box"),),
        (TEST_PIPELINE + "::test_a_lens_changes_nothing_but_the_pixels",),
    ),
    Mutation(
        "size-conditioning-sign",
        "a longer car is told as a shorter one",
        "fgrecon/solve/vehicle/conditioning.py",
        (("scaled.T @ whitener @ (size.mean - known.mean)", "scaled.T @ whitener @ (known.mean - size.mean)"),),
        ("tests/solve/vehicle/test_conditioning.py",),
    ),
    Mutation(
        "track-shape-not-shared",
        "every image of a track has a shape of its own",
        TRACK,
        (
            (
                "VehicleGraph(problem, pose, pose_free=True, frame=number, shape_terms=first)",
                "VehicleGraph(problem, pose, pose_free=True, frame=number, vehicle=number)",
            ),
            (
                "        values.insert(frame.graph.pose_key, frame.state.pose)\n",
                "        values.insert(frame.graph.values(frame.state.pose, coefficients, frame.state.offsets))\n",
            ),
        ),
        (TEST_TRACK,),
    ),
    Mutation(
        "track-prior-once-per-image",
        "the terms of a track's shape are counted once for every image",
        TRACK,
        (("frame=number, shape_terms=first)", "frame=number, shape_terms=True)"),),
        (TEST_TRACK,),
    ),
)

MUTATIONS = (*DROPPED_TERMS, *WRONG_SIGNS, *DISCARDED, *WRONG_WEIGHTS, *WRONG_ANSWERS)
