"""Settings of the pose search, in one place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors.surface_points import PointOdds


@dataclass(frozen=True)
class RestartSettings:
    """Of the second search, where a pose rests on few keypoints (`fgrecon.solve.proposals.restarts`); not tuned."""

    all_round_starts: int = 48
    """Starts in the 2D box, all round."""
    nearby_starts: int = 24
    """Starts about the pose."""
    first_iterations: int = 4
    """Iterations of all starts."""
    first_kept_hypotheses: int = 24
    """How many go on after `kept_from_iteration`."""
    starts_per_keypoint: int = 12
    """Starts in the box, and as many about the pose, for each keypoint that is assumed right."""
    keypoint_iterations: int = 6
    """Their iterations."""
    keypoint_kept_hypotheses: int = 6
    """How many of them go on."""
    kept_from_iteration: int = 3
    """Iteration from which only the best go on: losers show early."""
    last_iterations: int = 8
    """Iterations of all that are left."""
    wrong_below_weight: float = 0.5
    """A keypoint of less weight is taken for wrong in the result."""
    least_right_probability: float = 0.1
    """What is less probably right is not assumed to be."""
    most_assumed_right: int = 4
    """Keypoints that are assumed right, the most probable ones."""
    never_wrong_density: float = 1e-200
    """Density of a wrong point that leaves no other explanation, and a logarithm."""
    most_poses: int = 3
    """Poses that are returned."""
    energy_gap_nats: float = 0.3
    """The graph, which has more freedom, lowers the energy by as much in the same place: less is no other pose."""
    same_turn_radians: float = float(np.deg2rad(4.0))
    """Poses that are nearer in turn and shift are one."""
    same_shift_metres: float = 0.15
    """The same of the shift."""
    log_depth_spread: float = 0.5
    """Of the starts in the box: of the logarithm of depth."""
    tilt_spread_radians: float = 0.2
    """Of the starts in the box: roll and pitch."""
    nearby_log_depth_spread: float = 0.3
    """Of the starts about the pose: of the logarithm of depth."""
    nearby_tilt_spread_radians: float = 0.15
    """Of the starts about the pose: roll and pitch."""
    nearby_turn_spread_radians: float = 0.5
    """Of the starts about the pose: heading."""
    azimuth_period: int = 3
    """Searches before the azimuths come again."""


_ODDS = PointOdds(
    vehicle=0.5,
    span=4.0,
    before=0.3,
    through=0.05,
    deepest=0.5,
    core=0.85,
    reach=0.1,
    reach_sigma=0.12,
    beyond=0.1,
    edge=0.5,
)


@dataclass(frozen=True)
class PointSettings:
    """Of measured points on a vehicle (`fgrecon.solve.proposals.point_term` and `point_search`).

    Chosen on drive 0000 of KITTI's tracking set, coarsely, where nothing else is said.
    """

    odds: PointOdds = _ODDS
    """How probably a point is the vehicle's, and what else it may be."""
    surface_sigma_m: float = 0.05
    """Of the surface's own error, added in quadrature: what no shape of the prior can meet."""
    independent_points: float = 100.0
    """Of n points n / (1 + n / this) count: the surface's errors are alike in neighbouring places."""
    common_factor: float = 20.0
    """By how much less points say of covariances: with it regions of 68 and 95 % hold about as many cars."""
    underside_sigma_m: float = 0.04
    """How high a vehicle stands is unsure by so much, however many points there are: they do not show its underside,
    and under it the road is off its plane. So much are labelled boxes of drive 0000 off the plane within 20 m."""
    box_sigma_share: float = 0.5
    """Of the standard deviation of a 2D box that encloses the projected 3D box, where there are points: it is for the
    errors of a shape at a distance that only the picture tells, and such boxes are half a pixel off."""
    independent_depths: float = 20.0
    """The same as `independent_points` of pixels of a depth map, whose errors are alike in neighbouring pixels."""
    pixel_sigma: float = 1.0
    """Of a depth map, across the rays."""
    sure_depth_share: float = 0.02
    """Of the distance, by which pixels of a depth map are unsure at most that measure how far a vehicle is: by stereo,
    which is less sure, cars came out worse with sizes as free as beside points."""
    most_pixels: int = 150
    """Of a depth map that are used of a vehicle."""
    most_points: int = 200
    """Of a vehicle that are used."""
    least_points: int = 3
    """Fewer say nothing."""
    cell_m: float = 0.1
    """Side of the cells of which one point is used."""
    frustum_margin: float = 0.1
    """Of the 2D box's longer side, by which it is enlarged to choose points; not tuned."""
    heights_m: tuple[float, float] = (1.0, 5.0)
    """Heights of vehicles that fill a 2D box at the nearest and the farthest depth from which points are taken."""
    start_quantiles: tuple[float, ...] = (0.25, 0.5, 0.75)
    """Of the points' distances, at which vehicles may begin; not tuned."""
    start_gap_m: float = 1.0
    """Of distances without points, behind which vehicles may begin as well; chosen on drive 0001, 0.7 is alike."""
    start_clusters: int = 4
    """Of points between such gaps, the largest; 3 and 6 are alike."""
    start_offsets_m: tuple[float, ...] = (1.0, 2.0)
    """From there to a vehicle's middle; not tuned."""
    azimuths: int = 8
    """All round, where the picture does not tell how a vehicle is turned."""
    least_carrying: float = 1.0
    """Keypoints' weights together, below which the picture's poses tell nothing; of 3, a hidden van went elsewhere."""
    larger_size_m: tuple[float, ...] = (4.9, 1.85, 2.0)
    """Length, width and height of a second kind of vehicle to start with: a van."""
    rough_sigma_m: float = 0.3
    """Of points at first."""
    searched_points: int = 96
    """Of a vehicle in the search; the graph has all. 64 missed twice as many cars whose end shows behind a wall."""
    rough_starts: int = 16
    """Starts that are refined roughly."""
    rough_iterations: int = 4
    """Of them."""
    iterations: int = 4
    """After those."""
    kept_from_iteration: int = 1
    """Iteration from which only the best go on."""
    kept_hypotheses: int = 5
    """How many of them."""
    least_in_middle: int = 5
    """In the middle of a 2D box, from which on it is said how many of them are the vehicle's; not tuned."""
    used_weight: float = 0.5
    """From which on a point is a vehicle's."""
    claimed_share: float = 0.5
    """Of the points of one of two vehicles: where so many are in the other's 3D box, both are in one place."""
    claimed_margin_m: float = 0.1
    """Around that box."""
    known_variable_sigma: float = 1e-6
    """Standard deviation of a scale, a shift or a sensor's place that is known: a graph needs some."""


@dataclass(frozen=True)
class MaskSettings:
    """Of silhouettes (`fgrecon.solve.proposals.mask_term`); not tuned where nothing else is said."""

    directions: int = 48
    """In the image, in each of which the farthest vertex and the mask's farthest point are compared."""
    right: float = 0.9
    """Probability that a vertex of the outline is on the mask's, and the mask's outline is the vehicle's."""
    span_share: float = 0.5
    """Of the mask's longer side, over which the others lie."""
    hidden_sigmas: float = 3.0
    """Of the outline's standard deviation, about what hides a vehicle: outlines there say nothing."""
    independent_rows: float = 24.0
    """As how many all comparisons count."""
    common_factor: float = 2.0
    """By how much less they say of covariances."""
    iterations: int = 8
    """Of the search where too few keypoints are measured or right, and the silhouette decides."""
    kept_from_iteration: int = 2
    """Iteration of it from which only the best go on."""


@dataclass(frozen=True)
class PoseSearchSettings:
    """Of the search over many poses (`fgrecon.solve.proposals.pose_search` and `search`).

    Where nothing else is said a number was not tuned.
    """

    iterations: int = 4
    """Levenberg-Marquardt iterations of all starts."""
    kept_hypotheses: tuple[tuple[int, int], ...] = ((1, 10), (3, 4))
    """Iteration, and how many hypotheses go on from it: losers show early."""
    distinct_turn_radians: float = float(np.deg2rad(20.0))
    """Poses that are turned by less against each other are one."""
    foreseen_azimuth_divisor: int = 2
    """Times fewer azimuths where a pose is foreseen: they are there for what else the keypoints allow."""
    heading_guess_radians: tuple[float, ...] = tuple(np.deg2rad([-30.0, 0.0, 30.0]).tolist())
    """Starts about a guess of the heading, which is trusted within 45 degrees."""
    pnp_least_right_probability: float = 0.3
    """Keypoints that are less probably right are left out of ASPnP."""
    pnp_least_keypoints: int = 4
    """ASPnP gives no starts from fewer."""
    largest_turn_radians: float = 0.5
    """A step may turn by: beyond, the linearisation says nothing."""
    settled_nats: float = 1e-4
    """Once no step changes any energy by more, the search is over."""
    alike_radians: float = float(np.deg2rad(8.0))
    """Hypotheses closer than that are one: half the distance of neighbouring starts."""
    first_damping: float = 1e-2
    """Of Levenberg-Marquardt, as a share of the diagonal."""
    damping_decrease: float = 0.3
    """Factor on the damping after a good step."""
    damping_increase: float = 5.0
    """Factor on the damping after a bad step."""
    ridge: float = 1e-9
    """Added to the diagonal: what nothing determines stays where it is."""
    most_right_probability: float = 0.99
    """No detector is surer than that of a keypoint, nor that it is wrong."""
    border_pixels: float = 2.0
    """From the image's border, within which a box edge says nothing."""
    box_softness_sigmas: float = 0.5
    """Softness of a box's extents: with 0.2 the solver zigzags over creases of the outline."""
    edge_wrong_probability: float = 0.1
    """That a box edge is wrong."""
    least_keypoints: int = 3
    """A pose needs so many."""
    most_outlier_density: float = 0.5
    """Below 1, so that a wrong point never explains a keypoint better than a right one."""
    model_noise_share: float = 0.1
    """Of the general noise's variance, added to a detector's covariance for what no shape of the prior can meet."""
    direction_meaningless_probability: float = 0.05
    """That the directions of a detector mean nothing: none costs more than its logarithm and a little."""
    points: PointSettings = PointSettings()
    """Of measured points."""
    masks: MaskSettings = MaskSettings()
    """Of silhouettes."""
    restarts: RestartSettings = RestartSettings()
    """Of the second search."""


SETTINGS = PoseSearchSettings()
"""What the search reads."""
