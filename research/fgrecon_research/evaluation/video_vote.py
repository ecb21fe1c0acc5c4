"""The vote: which way a vehicle faces if one merely adds up what the network says of its frames.

The least that time can tell of a facing, and what everything else over time has to beat. Each frame keeps its single
image's result, turned round where the sum of the network's log odds over the track says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.detection import facing_probability
from fgrecon.core.geometry import view_azimuth
from fgrecon.core.half_turn import HALF_TURN
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.perception.keypoints.decode import logit

Array = NDArray[np.float64]


def vote(
    track: Sequence[tuple[Reconstruction, Array | None]],
) -> list[tuple[Reconstruction, Reconstruction]]:
    """The results of one vehicle, turned round where the log odds of the frames so far, and of all, say so.

    A frame's log odds are those of the half of all directions around the one that its result is seen from. From frame
    to frame the vehicle turns by less than a quarter, so that results beyond that face the other way.

    Args:
        track: Each frame's result and the network's directions (A,), None where there are none, in the order of time.
    """
    results = [result for result, _ in track]
    poses = np.array([result.camera_T_object for result in results])
    azimuths = view_azimuth(poses[:, :3, :3], poses[:, :3, 3])
    halves = [
        0.5 if directions is None else facing_probability(directions, azimuth)
        for (_, directions), azimuth in zip(track, azimuths.tolist(), strict=True)
    ]
    yaws = np.array([result.rotation_y for result in results])
    other_way = np.cumsum(np.cos(np.diff(yaws, prepend=yaws[0])) < 0.0) % 2 == 1  # than the first result
    way = np.where(other_way, -1.0, 1.0)
    odds = way * logit(np.array(halves))
    so_far, of_all = way * np.cumsum(odds) < 0.0, way * odds.sum() < 0.0
    return [
        (_turned(result) if now else result, _turned(result) if at_last else result)
        for result, now, at_last in zip(results, so_far.tolist(), of_all.tolist(), strict=True)
    ]


def _turned(result: Reconstruction) -> Reconstruction:
    """With a pose that is turned round, and its covariance along the axes of that."""
    signs = np.tile(np.diag(HALF_TURN)[:3], 2)
    spread = result.uncertainty.pose_covariance
    covariance = None if spread is None else spread * np.outer(signs, signs)
    return replace(
        result,
        pose=replace(result.pose, camera_T_object=result.camera_T_object @ HALF_TURN),
        uncertainty=replace(result.uncertainty, pose_covariance=covariance),
    )
