"""Settings of vehicles over time.

Those that say so were chosen on KITTI's video; of the others it is not recorded on what.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class TimeSettings:
    """Settings of the heading's filter, of a vehicle's window, of its motion and of smoothing."""

    # The heading by one frame
    pose_heading_sigma_rad: float = float(np.deg2rad(8.0))  # of the heading of a pose
    energy_temper: float = 0.3  # share of a difference of energies that counts: outlines and points err together
    flip_probability_beside_directions: float = 0.4  # of keypoints as a whole; directions say all of front and rear
    flip_probability: float = 0.1  # the same where no directions are given
    uninformative_probability: float = 0.05  # that poses, a path or a box say nothing of the heading
    uninformative_directions_probability: float = 0.05  # that a network's directions say nothing
    reverse_probability: float = 0.03  # that a vehicle that moves drives backwards
    full_height_px: float = 60.0  # lower vehicles show less, and frames err alike the more
    unscored_pose_excess_nats: float = 3.0  # of other poses by a strategy without an energy; not tuned
    # The heading over time
    view_azimuth_rad: float = float(np.deg2rad(15.0))  # from so much further round a network's look is another one
    view_log_height: float = 0.3  # and so is one from so much nearer; chosen on drives 0095, 0009, 0013 and 0005
    view_images: float = 2.0  # that many frames of one view count as together, at most; on the same drives
    view_half_frames: float = 4.0  # of which they count as half of that; on the same drives
    recent_share: float = 0.12  # of the last image in the average of the last ones; on the same drives
    turn_rate_sigma_rad: float = 0.3  # that a vehicle turns in a second
    jump_probability_per_s: float = 1e-7  # that it faces elsewhere: frames of another vehicle begin anew
    same_side_rad: float = float(np.deg2rad(60.0))  # headings further apart are of different poses
    pose_excess_nats: float = 12.0  # a pose that is worse by more is none that the keypoints allow
    flip_gain_nats: float = 3.0  # by which flipped keypoints must explain a pose better: one time in twenty
    # The heading by the path of a vehicle
    path_m: float = 2.0  # that it must have gone
    place_sigma_m: float = 0.3  # how exactly its place is known, beside what grows with depth
    place_sigma_per_m: float = 0.05
    # The class over time
    class_correlation_s: float = 0.3  # what frames of so much time say together is what one of them says; not tuned
    least_class_probability: float = 0.02  # that any frame leaves to a class; not tuned
    class_change: float = 0.3  # of a class's probability, from which on a vehicle's frames are made anew; not tuned
    farthest_coefficient: float = 3.0  # at which a shape of another class begins; not tuned
    # The window
    window_iterations: int = 8
    """Most of it was solved with the frame before. With four some windows end on the way where no shape fits, and
    rounding grows from frame to frame: 1e-9 pixels moved 45 of KITTI's 2,184 boxes by 5 cm online, now none."""
    window_span_s: float = 4.0  # older frames leave, but for the last two
    contradiction_nats: float = 25.0  # against the motion before: up to 18 on KITTI where it is right, from 87 else
    agreement_nats: float = 8.0  # of a frame after an odd one with those before: 99 % on KITTI are below 6
    explained_share: float = 0.2  # of its keypoints' weights by itself: with less a frame contradicts those before
    simultaneous_s: float = 1e-4  # nothing moves between frames that are no further apart: they are of two cameras
    highest_speed_m_per_s: float = 60.0  # that a vehicle is taken to have when it is observed for the second time
    # Whether a vehicle stands
    driving_gain_nats: float = 7.0
    """By which driving must explain the frames better than standing: the logarithm of the thousand speeds that there
    are, as exactly as frames tell one. On KITTI's video parked vehicles stay at 6.6 or below, by two networks, and
    those that drive begin at 10.5."""
    driving_margin_nats: float = 3.0  # more or less than that: what leaves open which it is
    driving_evidence_s: float = 0.5  # frames of less time do not say which it is
    driving_recheck_s: float = 0.3  # after which it is decided anew, where it was certain
    # Motion, 1 sigma in a second: rotations (3,) and translations (3,), along the vehicle's axes
    motion_sigma: tuple[float, ...] = (0.02, 0.05, 0.02, 0.2, 0.1, 0.1)  # that constant velocity and turn rate miss
    unknown_camera_sigma: tuple[float, ...] = (
        0.1,
        0.1,
        0.1,
        0.5,
        0.5,
        0.5,
    )  # where the camera moves unknown: it pitches
    relative_velocity_walk: tuple[float, ...] = (4.0, 4.0, 0.5)  # of a velocity relative to a moving camera
    velocity_sigma: tuple[float, ...] = (30.0, 30.0, 1.0)  # of any velocity: metres per second, and radians per second
    standing_turn_rate_rad_per_s: float = 0.02  # how fast what stands seems to turn
    standing_loss_sigmas: float = 2.0  # from which on a vehicle drives; scaled as its noise is
    longest_velocity_s: float = 1.0  # that one velocity stands for
    # The camera, and smoothing
    camera_drift_m2: float = 1e9  # of a way that is less sure rounding hides what comes next
    stretch_frames: int = 100  # that are smoothed together
    overlap_frames: int = 20


SETTINGS = TimeSettings()
