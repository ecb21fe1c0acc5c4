"""From the frames of a video to tracked vehicles.

`ImageTracker` takes one image after the other and returns estimates. `run_video` does what `fgrecon run` does: a
`FrameDetector` finds vehicles and keypoints in each frame, a `MotionEstimator` estimates how the camera has moved, a
`Follower` gives ids (`GatedAssociation`, or any `Association`) and has a tracker estimate (`fgrecon.Tracker`, or any
`VehicleTracker`). `camera_motion` estimates the motion between two images, `read_given` reads vehicles that others have
found, `estimate_camera` a focal length that nobody knows.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from factors.lazy import lazy_names

if TYPE_CHECKING:  # imported when used
    from fgrecon.io.frames import open_frames
    from fgrecon.io.poses import CameraPoses, read_poses
    from fgrecon.io.source_frames import SourceFrame
    from fgrecon.io.video_frames import write_video
    from fgrecon.video.association import Association, AssociationSettings, Candidate, GatedAssociation
    from fgrecon.video.camera_path import CameraPath, MotionEstimator
    from fgrecon.video.egomotion import CameraMotion, camera_motion
    from fgrecon.video.focal import EstimatedCamera, estimate_camera
    from fgrecon.video.follow import Follower, TrackedFrame, VehicleTracker
    from fgrecon.video.frame_detector import FrameDetector
    from fgrecon.video.given import Given, read_given
    from fgrecon.video.image_tracker import ImageTracker, SingleImageTracker
    from fgrecon.video.newest import Newest
    from fgrecon.video.records import FrameRecord, Sighting
    from fgrecon.video.rows import frame_lines, rows_of, tracking_text
    from fgrecon.video.run import VideoRun, run_video

__all__ = [
    "Association",
    "AssociationSettings",
    "CameraMotion",
    "CameraPath",
    "CameraPoses",
    "Candidate",
    "EstimatedCamera",
    "Follower",
    "FrameDetector",
    "FrameRecord",
    "GatedAssociation",
    "Given",
    "ImageTracker",
    "MotionEstimator",
    "Newest",
    "Sighting",
    "SingleImageTracker",
    "SourceFrame",
    "TrackedFrame",
    "VehicleTracker",
    "VideoRun",
    "camera_motion",
    "estimate_camera",
    "frame_lines",
    "open_frames",
    "read_given",
    "read_poses",
    "rows_of",
    "run_video",
    "tracking_text",
    "write_video",
]

__getattr__, __dir__ = lazy_names(__name__)
