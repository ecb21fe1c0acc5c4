"""Settings of the stages that are in `solve` itself: headings, scenes, the road, and status."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class FacingSettings:
    """Which way the vehicles of one image face; not tuned beyond the pairs counted for `core.heading_coupling`."""

    neighbour_share: float = 0.3  # of what two vehicles say of one another, since a row's say much the same
    neighbour_distance_m: float = 20.0
    detector_error_probability: float = 1e-4  # that a detector takes the front for the rear, however sure


@dataclass(frozen=True)
class FittedClassSettings:
    """How much the energies of a vehicle as one of either class say of which it is.

    The share was fitted to the boxes of cars and vans of drives 0095, 0005 and 0013 (0.59).
    """

    energy_temper: float = 0.6  # share of a difference that counts: keypoints of one image err together
    most_nats: float = 15.0  # of a difference that counts
    least_probability: float = 1e-3  # of a class that another program leaves open; not tuned
    solved_images: int = 8  # of a track, spread over it, as one of each class for its covariances; not tuned


@dataclass(frozen=True)
class SceneSettings:
    """Vehicles of one image that are solved together."""

    single_visibility_step: float = 1e-2
    """Where vehicles that are about to be solved together end alone, as `optimise` has it: near enough for the same
    basins. Where visibility swings another one may be held then, which moves one box in a hundred by more than a
    centimetre, as often closer to the truth as further away."""
    joint_visibility_step: float = 5e-4
    """The same of the scene: half a millimetre, where a result is known to some centimetres at best."""
    same_place_widths: float = 0.5
    """Two vehicles nearer than so many widths are one, or one of them is wrong: no others fit there."""
    same_point_sigmas: float = 2.0  # of the noise of two keypoints, up to which they are at one point; not tuned
    most_certain_claim: float = 0.999
    """Confidence from which on two claims to one point are as good as each other; not tuned."""
    # The ground; chosen on KITTI's video (docs/explanation/method.md)
    own_height_share: float = 0.35
    """Share of a given ground's deviation that is each vehicle's own. Of a ground that is given more vaguely than
    `Ground` is by itself it is that of what `Ground` has: vehicles are as near to their road, whatever is known."""
    own_slope_share: float = 0.15
    own_tilt_share: float = 0.5
    least_camera_height_m: float = 0.2  # above the road
    least_normal_down: float = 0.1
    """Of the normal of a ground: cameras look along it rather than at it, and none is rolled by a quarter turn."""
    estimated_ground_sigma: tuple[float, ...] = (0.5, 0.3, 0.1)
    """Metres, radians, radians: prior of height, pitch and roll where no ground is given; not tuned."""
    contact_loss_sigmas: float = 3.0  # from which on a contact counts less; not tuned
    # The focal length
    focal_candidates: int = 9  # that are tried; not tuned
    focal_reach_sigmas: float = 2.0  # of the prior that are tried
    focal_start_excess_nats: float = 5.0  # a minimum over the candidates that is worse by more is no start
    focal_starts: int = 2
    same_focal_log: float = 0.02  # logarithms that differ by less are of one focal length
    # Another detector's 3D boxes
    box_keypoint_inflation: float = 8.0
    """Keypoints of one image err together, and beside another opinion they count with so many times their variance. Of
    1, 2, 4, 8 and 16 the best on 186 cars of six drives of KITTI's video with disturbed boxes; 16 is as good."""
    box_definition_m: float = 0.05  # where people and detectors put a box differs by so much however near it is
    refined_keypoints: int = 3  # that must be trusted: a pose needs as many
    refined_contradiction_sigmas: float = 4.0  # of the box's errors: further off is another vehicle, or wrong


@dataclass(frozen=True)
class GroundFilterSettings:
    """The ground over time; on what these were chosen is not recorded."""

    correlation_s: float = 0.3  # after which what vehicles say of the ground counts whole again
    deviation_s: float = 12.0  # after which a deviation from what is given has fallen to a third, and another has come
    estimated_change_s: float = 0.1
    """In which a ground that nobody gave may change by as much as it is unsure: the camera may be in a hand."""
    near_m: float = 10.0  # the depths at which the uncertainty is that of the ground's
    far_m: float = 40.0
    least_kept: float = 1e-6  # of what was known
    ground_iterations: int = 1  # Newton's, of the vehicles together: each begins near its minimum
    farthest_camera_m: float = 1e6  # a camera that is further away has come there in an unknown way
    shortest_s: float = 1e-6  # from frame to frame: noise that grows with time must not vanish
    largest_window: int = 100  # frames


@dataclass(frozen=True)
class SensorFilterSettings:
    """The shared error of a sensor's depth maps over time (`fgrecon.solve.sensor_filter`); not tuned."""

    drift_s: float = 600.0  # in which it may change by as much as it is unsure before any vehicle
    least_share: float = 0.33  # of that deviation: sizes of fleets are wrong alike, so many vehicles make it no surer
    loss_sigmas: float = 2.0  # from which on a vehicle counts less
    reweighings: int = 20
    most_vehicles: int = 50  # the last ones: of a sensor that was moved the new ones outnumber the others some time
    iterations: int = 8  # Newton's, of a vehicle alone: it begins near its minimum
    least_gain: float = 1e-3  # of information, by which a vehicle says something


@dataclass(frozen=True)
class DepthScaleSettings:
    """Of a first scale and shift of depth maps (`fgrecon.solve.depth_scale`).

    Chosen coarsely on drives 0000 and 0001 of KITTI's tracking set.
    """

    vehicle_pixels: int = 200  # of a vehicle that are looked at
    parts: int = 3  # of a vehicle by depth, whose medians are samples
    vehicle_sigma: float = 0.06  # of the logarithm of a vehicle's depth by the picture
    ground_pixels: int = 1000  # of the image
    ground_m: tuple[float, float] = (4.0, 40.0)  # depths between which the ground is looked at
    ground_sigma: float = 0.02  # of the logarithm of its depth, beside the plane's own errors
    independent_ground: float = 100.0  # so many of its pixels count
    height_share: float = 0.02  # of the camera's height over the ground, by which it is unsure
    least_samples: int = 3
    pairs: int = 500  # of samples that are tried
    outlier_sigmas: float = 1.5  # beyond, a sample is as wrong as any
    loss_sigmas: float = 2.0  # from which on a sample counts less
    inflation: float = 4.0  # of the standard deviations: no road is a plane
    wide_log_scale: float = 0.5  # how sure scale and shift are before anything says more: of the logarithm,
    wide_shift: float = 0.5  # and in shares of the vehicles' median (inverse) depth
    no_shift: float = 1e-6  # the same where there is none


@dataclass(frozen=True)
class RoadSettings:
    """Of the measured points' plane that is the ground (`fgrecon.solve.road_plane`); not tuned but where it says so."""

    height_sigma: float = 0.05  # how far roads are off a plane, metres; chosen on drive 0000 of KITTI's tracking set
    slope_sigma: float = 0.006  # and radians; likewise
    depth_m: tuple[float, float] = (3.0, 60.0)  # between which points are looked at
    side_m: float = 15.0  # to either side
    cell_m: float = 1.0  # side of a cell
    lowest_share: float = 0.9  # of its points that are above the one that is taken
    pixels: int = 20000  # of a depth map
    start_percentile: float = 80.0  # of the heights of near cells: a first guess where no ground is given
    scales_m: tuple[float, ...] = (0.3, 0.1, 0.05)  # of the robust loss, one after the other
    reweighings: int = 50  # at most, for each of them
    converged: float = 1e-4  # change of the height in metres, and of the slopes, that is none
    inlier_m: float = 0.15
    least_cells: int = 40  # on the plane
    least_share: float = 0.25  # of all cells
    least_spread_m: tuple[float, float] = (2.5, 8.0)  # across and along, of nine tenths of them
    correlated_cells: float = 9.0  # so many count as one
    typical_m: float = 15.0  # depth where heights are least tied to slopes
    held_s: float = 1.0  # for which it stays the ground of a tracker's frames without points
    excluded_sigmas: float = 12.0  # of a given ground, by which the plane may differ from it: roads are banked


@dataclass(frozen=True)
class StatusSettings:
    """Limits of trust in results; chosen on five drives of KITTI's video, tested on two (docs/reference/result.md)."""

    ambiguous_facing: float = 0.8  # less is ambiguous: 80 % of the cars that are flipped, and 6 % of the others
    sure_facing: float = 0.953  # of a facing over time, which is not ambiguous then whatever its frame says; not tuned
    size_ratio: float = 5.0  # times longer, wider or higher than the prior's mean, or as many times less: no vehicle
    rotation_sigma_rad: float = float(np.deg2rad(30.0))  # a rotation known no better than this is not determined
    small_turn_deg: int = 10  # of an alternative that is turned by less it is said how far away it is
    # Weak results
    carrying_keypoints: float = 5.5  # weight: with two equations each, fewer than pose and shape have unknowns
    points_a_keypoint: float = 4.0  # measured points that carry as much as a keypoint; not tuned
    fitting_keypoints: float = 0.8
    """Share of the keypoints that the detector holds right, of which at least so many fit where points were measured.
    Chosen on drive 0003 of KITTI's tracking set, whose right scans leave 0.91 and more, and tested on two others."""
    right_keypoints: float = 0.25  # of the measured ones by the detector; a half where it gives no confidences
    off_ground_sigmas: float = 2.0
    leaning_sigmas: float = 1.5  # of a car on the given ground; chosen on simulated ones: at most 1.1, and 1.5 to 3.6
    # where the camera that was given as level is rolled by 10 degrees
    leaning_together_sigmas: float = 1.75
    """Of cars of an image, which may lean together. With the camera rolled by 10 degrees 92 % of simulated ones lean
    more; of KITTI's in 85 images 5 of 220, on roads that are banked by 3 degrees."""
    fastest_m_per_s: float = 150.0  # of a vehicle over the camera or the ground; not tuned
    outside_image: float = 0.5  # of the vehicle's 2D box
    large_box_excess: float = 0.2
    """By which a 2D box is larger than its vehicle looks: a wrong one. Of 318 cars of five drives of KITTI's tracking
    set that converged with labelled boxes it is 0.15 at most; boxes one and a half times as large have 0.2 to 0.6."""
    shape_sigmas: float = 3.0  # of a shape coefficient
    rough_focal_log: float = 0.1
    """Standard deviation of a focal length's logarithm: beyond, distances are off by more than the 20 % that count as
    wrong more often than those of other results that converged."""
    open_focal_log: float = 0.3  # beyond, half of the distances are wrong
    contradicted_nats: float = 8.0
    """By which image and shape prior fit worse with factors of the caller's own than without, if they contradict them.
    Chosen with the labels' motions and distances on drives 0001 and 0006 of KITTI's tracking set, tested on three."""
    contradicted_median_nats: float = 5.0  # the same of several images of a vehicle, whose median it is
    # 2D boxes of several vehicles
    box_vehicles: int = 5  # that it takes to say something
    box_excess: float = 0.05  # that is usual: the package's own sources have -3 to 2 % on KITTI's video
    box_excess_sigmas: float = 3.0  # standard errors of the median
    # Probabilities of poses
    energy_temper: float = 0.15  # of a nat's worth: makes poses of one facing as probable as they are on KITTI's video
    facing_log_odds: float = 1.05  # where energies alone tell: fitted to 4,200 simulated vehicles
    facing_log_odds_per_nat: float = 0.128
    facing_margin_nats: float = 35.0  # beyond, more margin made no facing surer
    facing_probability: float = 0.01  # a facing that is less probable need not have a pose


FACING, SCENE, GROUND_FILTER, STATUS = FacingSettings(), SceneSettings(), GroundFilterSettings(), StatusSettings()
DEPTH_SCALE, ROAD, FITTED_CLASS = DepthScaleSettings(), RoadSettings(), FittedClassSettings()
SENSOR_FILTER = SensorFilterSettings()
