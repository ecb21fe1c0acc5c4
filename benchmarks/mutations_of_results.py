"""Faults in what becomes of a solution."""

from __future__ import annotations

from benchmarks.mutation import (
    ADJUST,
    COVARIANCE,
    FACING,
    GRAPH,
    OBSERVATION,
    OPTIMISE,
    PROPOSALS,
    RESULT,
    SOLVER,
    TEST_ADJUST,
    TEST_BASINS,
    TEST_COVARIANCE,
    TEST_EXTRA,
    TEST_FACING,
    TEST_OPTIMISE,
    TEST_PIPELINE,
    TEST_PROPOSALS,
    TEST_RECOVERY,
    TEST_STATUS,
    TEST_TRACK,
    TEST_WEIGHTS,
    TEST_WIDER,
    VEHICLE,
    Mutation,
)

__all__ = ["DISCARDED", "WRONG_ANSWERS"]

DISCARDED = (
    Mutation(
        "solutions-thrown-away",
        "every result of GTSAM is replaced by its start",
        SOLVER,
        (
            ("    return Solution(values, tuple(path), error,", "    return Solution(gtsam.Values(start), (), error,"),
            ("    converged = decrease <=", "    converged = True or decrease <="),
        ),
        (TEST_RECOVERY, TEST_PIPELINE, TEST_TRACK),
        red=15,
    ),
    Mutation(
        "graph-thrown-away",
        "the result is the best proposal, whatever the graph has found",
        ADJUST,
        (
            (
                "    return MultiStartResult(replace(optimum, iterations=",
                (
                    "    state = State(start.poses, start.shapes, optimum.state.weights)\n"
                    "    return MultiStartResult(replace(optimum, state=state, iterations="
                ),
            ),
        ),
        (TEST_RECOVERY, TEST_PIPELINE, TEST_TRACK),
        red=15,
    ),
    Mutation(
        "never-unfinished",
        "a solve that is stopped short of its minimum counts as converged",
        SOLVER,
        (("converged = decrease <= max(relative_tolerance * error, NEGLIGIBLE)", "converged = True"),),
        ("tests/solve/graph/test_solver.py",),
    ),
    Mutation(
        "loop-never-unfinished",
        "re-weighting that does not come to rest counts as converged",
        OPTIMISE,
        (("            before = moved\n        self.converged = False\n", "            before = moved\n"),),
        (TEST_OPTIMISE + "::test_a_loop_that_never_comes_to_rest_says_so",),
    ),
    Mutation(
        "joint-pose-thrown-away",
        "the poses of the graph are not taken over",
        GRAPH,
        (
            (
                "        poses = [part.pose(values) for part in self.observations]\n",
                "        poses = [part._pose for part in self.observations]\n",
            ),
        ),
        (TEST_RECOVERY, TEST_TRACK),
        red=4,
    ),
    Mutation(
        "shape-thrown-away",
        "lambda and offsets of the graph are not taken over",
        VEHICLE,
        (
            ("else values.atVector(key)\n", "else np.zeros(self.shape.dims[0])\n"),
            ("else values.atVector(offsets_key).reshape(-1, 3)", "else np.zeros((self.shape.size, 3))"),
        ),
        (TEST_RECOVERY, TEST_TRACK),
        red=4,
    ),
    Mutation(
        "graph-weights-never-updated",
        "the graph keeps the weights of the pose search",
        OBSERVATION,
        (
            (
                "        return Weights(weights, visibility, edges, depth)",
                "        return Weights(before.keypoints, visibility, edges, depth)",
            ),
        ),
        (TEST_WEIGHTS,),
    ),
    Mutation(
        "graph-anneals-not",
        "graduated non-convexity is at its end from the first update on",
        OPTIMISE,
        (("self.reweigh(min(update / max(updates - 1, 1), 1.0))", "self.reweigh(1.0)"),),
        (TEST_ADJUST + "::test_every_update_starts_where_the_last_one_ended_and_goes_down",),
    ),
    Mutation(
        "one-update-only",
        "the weights are updated once, however many updates are asked for",
        OPTIMISE,
        (
            ("        updates = max(self.strategy.updates, 1)\n", "        updates = wanted = 1\n"),
            ("wanted = updates if", "_ = updates if"),
        ),
        (TEST_ADJUST, TEST_WEIGHTS),
    ),
    Mutation(
        "visibility-never-updated",
        "the graph keeps the visibility of the pose search",
        OBSERVATION,
        (
            (
                "        if not hold:\n            visibility, depth =",
                "        if False:\n            visibility, depth =",
            ),
        ),
        (TEST_ADJUST + "::test_every_update_starts_where_the_last_one_ended_and_goes_down",),
    ),
    Mutation(
        "depth-never-updated",
        "the ground's uncertainty stays that of the proposal's depth",
        OBSERVATION,
        (("[0], float(pose.z())", "[0], before.depth"),),
        (TEST_ADJUST,),
    ),
    Mutation(
        "visibility-not-held",
        "the second part makes visibility anew at every update",
        OPTIMISE,
        (("            self.reweigh(1.0, hold=True)\n", "            self.reweigh(1.0)\n"),),
        (TEST_OPTIMISE,),
    ),
    Mutation(
        "cycle-ends-anywhere",
        "of the states of a cycle the last one is taken, not the best",
        OPTIMISE,
        (("                _, self.values, self.weights = best\n", "                pass\n"),),
        (TEST_OPTIMISE + "::test_a_cycle_of_visibility_ends_at_the_better_of_its_states",),
    ),
    Mutation(
        "guess-always-taken",
        "a guess ahead is taken even where the energy is higher there",
        OPTIMISE,
        (("        if not self.energy() < energy:\n            self.values = here\n", ""),),
        (TEST_OPTIMISE,),
    ),
    Mutation(
        "never-settled",
        "the weights are not updated until the solver rests: the second part has one update",
        OPTIMISE,
        (
            ("for _ in range(_MOST_UPDATES):", "for _ in range(1):"),
            ("        self.converged = False\n", "        pass\n"),
        ),
        (TEST_ADJUST + "::test_the_result_is_the_minimum_for_its_weights", TEST_OPTIMISE),
    ),
    Mutation(
        "alternatives-never-refined",
        "only the best proposal is refined by the graph",
        ADJUST,
        (
            (
                "for one in [first, *map(refine, _matter(start))]",
                "for one in [first, *map(refine, _matter(start)[:0])]",
            ),
        ),
        (TEST_BASINS, TEST_EXTRA),
        red=2,
    ),
    Mutation(
        "never-searched-on",
        "a result that rests on few keypoints is taken as it is",
        ADJUST,
        (("        if not _rests_on_few(", "        if True or not _rests_on_few("),),
        (TEST_WIDER,),
        red=5,
    ),
    Mutation(
        "worst-proposal-wins",
        "of the refined proposals the one with the highest energy is the result",
        ADJUST,
        (("    best = min(solved,", "    best = max(solved,"),),
        (TEST_BASINS,),
    ),
    Mutation(
        "change-over-never",
        "every image of a track stays in the basin that it started in",
        ADJUST,
        (("        if not any(chosen):\n", "        if True:\n"),),
        (TEST_BASINS + "::test_images_that_start_in_the_wrong_basin_change_over",),
    ),
    Mutation(
        "turns-cost-nothing",
        "neighbours of a sequence may be turned round against each other",
        FACING,
        (("between.append(-cost if in_order", "between.append(-0.0 * cost if in_order"),),
        (TEST_FACING,),
    ),
    Mutation(
        "turns-always-cost",
        "images in no order are taken for a sequence",
        FACING,
        (("else np.zeros_like(cost))", "else -cost)"),),
        (TEST_FACING,),
    ),
    Mutation(
        "chain-forgets",
        "the most probable basins are those of the last image's own energy",
        FACING,
        (("        score = through.max(axis=0) + own\n", "        score = own\n"),),
        (TEST_FACING,),
    ),
    Mutation(
        "extra-factors-dropped-on-reweighting",
        "factors of the caller's own are in the first solve alone",
        GRAPH,
        (
            (
                "        for factor in [*own, *self.extra]:\n",
                "        extra, self.extra = self.extra, []\n        for factor in [*own, *extra]:\n",
            ),
        ),
        (TEST_EXTRA,),
        red=2,
    ),
    Mutation(
        "extra-factors-not-in-alternatives",
        "the other proposals are refined without the caller's factors",
        ADJUST,
        (
            (
                "return _run(seen, start_state(seen, [moved]), extra, steady)",
                "return _run(seen, start_state(seen, [moved]), (), steady)",
            ),
        ),
        (TEST_EXTRA,),
    ),
    Mutation(
        "extra-factors-not-in-covariance",
        "the pose of an image of a track is as unsure as without the caller's factors",
        COVARIANCE,
        (
            (
                "    information = np.linalg.inv(joint[:6, :6] - by_shape @ joint[6:, :6])\n",
                "    information = left_out[:6, :6] * part.share / (1.0 - part.share)\n",
            ),
        ),
        (TEST_EXTRA,),
    ),
    Mutation(
        "extra-keys-not-checked",
        "a factor on a variable that the graph has not is left out without a word",
        GRAPH,
        (("        if pose_free and not hold_shape and len(self.extra) < len(extra):", "        if False:"),),
        (TEST_EXTRA,),
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
        OBSERVATION,
        (("box.weights(self._edges(values))[0]", "np.ones(4)"),),
        (TEST_WEIGHTS,),
    ),
)

WRONG_ANSWERS = (
    Mutation(
        "aspnp-starts-dropped",
        "the search does not start from the minima of ASPnP",
        PROPOSALS,
        (("        parts.append(_from_aspnp(problem))\n", "        pass\n"),),
        (TEST_PROPOSALS,),
    ),
    Mutation(
        "aspnp-unweighted",
        "ASPnP trusts every keypoint alike",
        PROPOSALS,
        (("aspnp(prior.mean[used], rays, weights[used], every=False)", "aspnp(prior.mean[used], rays, every=False)"),),
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
        (("for i in distinct(best)[1:]", "for i in distinct(best)[:0]"),),
        (TEST_PROPOSALS,),
    ),
    Mutation(
        "covariance-swapped",
        "the pose's covariance has translation before rotation",
        COVARIANCE,
        (
            (
                "pose = joint_covariance(marginals, [part.pose_key])",
                "pose = np.roll(joint_covariance(marginals, [part.pose_key]), 3, (0, 1))",
            ),
        ),
        (TEST_COVARIANCE,),
    ),
    Mutation(
        "track-covariance-by-share",
        "the pose of an image is as unsure as if the image had said a share alone",
        COVARIANCE,
        (("        if part.share < 1.0:\n", "        if False:\n"),),
        (TEST_TRACK + "::test_copies_of_an_image_count_as_their_common_error_says",),
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
        "fgrecon/core/observation.py",
        (("replace(self, keypoints=keypoints, box=box)", "replace(self, keypoints=keypoints)"),),
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
        "fgrecon/solve/track.py",
        (
            (
                "seen.append(GraphObservation(problem, image=number))",
                "seen.append(GraphObservation(problem, vehicle=number, image=number))",
            ),
            ("history=Deferred(lambda: joint_steps(adjusted.stages)) if keep else (),", "history=(),"),
        ),
        (TEST_TRACK,),
        red=2,
    ),
    Mutation(
        "track-prior-once-per-image",
        "the terms of a track's shape are counted once for every image",
        GRAPH,
        (
            (
                "        for vehicle in self.vehicles.values():\n            yield from",
                "        for vehicle in (part.vehicle for part in self.observations):\n            yield from",
            ),
        ),
        (TEST_TRACK,),
    ),
)
