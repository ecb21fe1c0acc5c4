"""A made-up track of one car with exact keypoints, in the format of the real files."""

import numpy as np

from fgrecon.core.camera import Camera

K = np.array([[700.0, 0.0, 600.0], [0.0, 700.0, 180.0], [0.0, 0.0, 1.0]])
T2 = np.array([0.06, -0.01, 0.02])


def pose_of(yaw, location):
    """camera_T_object of an upright car."""
    camera_T_object = np.eye(4)
    c, s = np.cos(yaw), np.sin(yaw)
    camera_T_object[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    camera_T_object[:3, 3] = location
    return camera_T_object


def make_track(prior, yaws, camera=None):
    """Content of a track file: the prior's mean car, seen exactly, turning on the spot 10 m ahead."""
    camera = camera or Camera(K)
    frames = []
    for number, yaw in enumerate(yaws, start=40):
        location = np.array([1.5, 1.65, 10.0])
        camera_T_object = pose_of(yaw, location + T2)
        points = prior.mean @ camera_T_object[:3, :3].T + camera_T_object[:3, 3]
        keypoints = camera.project(points)
        frames.append(
            {
                "frame": number,
                "box_xyxy": [*(keypoints.min(0) - 5), *(keypoints.max(0) + 5)],
                "keypoints_uv": keypoints.tolist(),
                "confidence": [0.9] * len(keypoints),
                "gt": {"location": location.tolist(), "rotation_y": float(yaw)},
            }
        )
    return {
        "K": K.tolist(),
        "P2": np.hstack([K, (K @ T2)[:, None]]).tolist(),
        "keypoint_names": list(prior.category.keypoints),
        "frames": frames,
    }
