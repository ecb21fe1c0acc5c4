"""Faults in the terms of the energy and in their weights."""

from __future__ import annotations

from benchmarks.mutation import (
    GRAPH,
    OBSERVATION,
    REPROJECTION,
    SEARCH,
    TERMS,
    TEST_COVARIANCE,
    TEST_DEFAULTS,
    TEST_GRAPH,
    TEST_PIPELINE,
    TEST_RECOVERY,
    TEST_REPROJECTION,
    TEST_SEARCH,
    TEST_TERMS,
    TEST_TRACK,
    TEST_VISIBILITY,
    TEST_WEIGHTS,
    VEHICLE,
    VISIBILITY,
    Mutation,
)

__all__ = ["DROPPED_TERMS", "WRONG_SIGNS", "WRONG_WEIGHTS"]

EVERY_TERM = TEST_SEARCH + "::test_the_search_minimises_every_term"


def _dropped_from_the_search(term: str, line: str) -> Mutation:
    what = f"the search minimises without the term of the {term}"
    return Mutation(f"search-without-{term}", what, SEARCH, ((line, "            pass\n"),), (EVERY_TERM,))


def _dropped_from_the_graph(term: str, line: str, left: str = "pass", file: str = VEHICLE) -> Mutation:
    indent = line[: len(line) - len(line.lstrip())]
    what = f"the graph has no factor for the {term}"
    return Mutation(f"graph-without-{term}", what, file, ((line, f"{indent}{left}\n"),), (TEST_GRAPH,))


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
    _dropped_from_the_graph("laplacian", '            present["laplacian"] = self._laplacian\n'),
    _dropped_from_the_graph(
        "planarity",
        '        self._faces = [] if "planarity" in disabled else self._bent_faces(category)\n',
        "self._faces = []",
    ),
    _dropped_from_the_graph("symmetry", '            present["symmetry"] = self._symmetry\n'),
    _dropped_from_the_graph(
        "rectangularity",
        "        self._rectangles = [face for face in faces if not self._vanishes(face)]\n",
        "self._rectangles = []",
    ),
    _dropped_from_the_graph("coefficients", '            present["coefficients"] = self._coefficients\n'),
    _dropped_from_the_graph("offsets", '            present["offsets"] = self._offsets\n'),
    _dropped_from_the_graph(
        "ground", '        terms["ground"] = self._ground(weights.depth, share)\n', file=OBSERVATION
    ),
    _dropped_from_the_graph("box", '        terms["box"] = self._box(share * weights.box)\n', file=OBSERVATION),
)

WRONG_SIGNS = (
    Mutation(
        "residual-sign",
        "a keypoint's residual points the other way than its Jacobian",
        REPROJECTION,
        (("return projection.pixels[i] - self.pixel,", "return self.pixel - projection.pixels[i],"),),
        (TEST_REPROJECTION,),
    ),
    Mutation(
        "rotation-jacobian-sign",
        "the derivative of the projection by the rotation is turned around",
        "factors/projection.py",
        (("cross(points[..., None, :], by_object)", "cross(by_object, points[..., None, :])"),),
        ("tests/factors/test_kernel.py", TEST_REPROJECTION),
    ),
    Mutation(
        "upright-jacobian-sign",
        "the derivative of the vehicle's lean is turned around",
        "factors/ground.py",
        (("by_turn[..., 1:, 2] = -rotation[..., 0]", "by_turn[..., 1:, 2] = rotation[..., 0]"),),
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
        (("jacobian[..., :3] = by_turn * scale", "jacobian[..., :3] = -by_turn * scale"),),
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
        OBSERVATION,
        (("Sigmas(box.sigma / np.sqrt(weights[used]))", "Sigmas(np.full(used.sum(), box.sigma))"),),
        (TEST_GRAPH,),
    ),
    Mutation(
        "stacked-noise-unweighted",
        "all keypoints count alike in the stacked factor",
        REPROJECTION,
        (
            (
                "    roots = keypoint_whiteners(finite_array(",
                (
                    "    some = np.asarray(weights, dtype=np.float64) > 0\n"
                    "    roots = some[:, None] * keypoint_whiteners(np.ones(len(some)), sigma, covariances)\n"
                    "    _ = keypoint_whiteners(finite_array("
                ),
            ),
        ),
        (TEST_REPROJECTION, TEST_GRAPH),
        red=4,
    ),
    Mutation(
        "stacked-noise-without-off-diagonal",
        "the correlation of u and v is left out of the stacked factor's noise",
        REPROJECTION,
        (("    matrix[first, first + 1] = b * c / information\n", ""),),
        (TEST_REPROJECTION, TEST_GRAPH),
        red=2,
    ),
    Mutation(
        "stacked-noise-transposed",
        "GTSAM is given the lower triangle of the stacked noise as the upper one",
        REPROJECTION,
        (
            ("    matrix[first, first] = information\n", "    matrix[first, first] = a\n"),
            ("    matrix[first, first + 1] = b * c / information\n", "    matrix[first, first + 1] = b\n"),
            ("= np.sqrt(np.maximum(c * c - (b * c / information) ** 2, 0.0))", "= c"),
        ),
        (TEST_REPROJECTION, TEST_GRAPH),
        red=2,
    ),
    Mutation(
        "keypoint-covariances-ignored",
        "the graph takes every keypoint's noise for isotropic",
        OBSERVATION,
        (("None if isotropic else covariances", "None"),),
        (TEST_GRAPH, TEST_COVARIANCE),
    ),
    Mutation(
        "loss-constant-unscaled",
        "an m-estimator's constant does not follow the keypoint's weight",
        OBSERVATION,
        (("loss.constant * weight**0.5)", "loss.constant)"),),
        (TEST_GRAPH, TEST_WEIGHTS),
        red=2,
    ),
    Mutation(
        "loss-weighs-twice",
        "where the graph has the m-estimator its weight is in the noise as well",
        OBSERVATION,
        (
            (
                "        return term.strategy.initial_weights(term.evidence, weights.visibility)\n",
                "        return weights.keypoints\n",
            ),
        ),
        (TEST_WEIGHTS,),
    ),
    Mutation(
        "common-error-ignored",
        "so many images of a car count as so many independent ones",
        GRAPH,
        (("return 1.0 / (1.0 + (images - 1) * options.shape.common_error)", "return 1.0"),),
        (TEST_TRACK + "::test_copies_of_an_image_count_as_their_common_error_says",),
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
