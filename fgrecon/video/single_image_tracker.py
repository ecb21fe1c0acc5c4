"""Baseline tracker without motion: every image on its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import FgreconError
from fgrecon.core.evidence import Evidence
from fgrecon.core.observation import Observation
from fgrecon.core.vehicle_estimate import VehicleEstimate
from fgrecon.solve.pipeline import reconstruct


class SingleImageTracker:
    """A tracker (`fgrecon.video.VehicleTracker`) that reconstructs every image on its own.

    Attributes:
        refused: Why vehicles of the last frame have no estimate, by id.
    """

    refused: Mapping[int, FgreconError]

    def __init__(self, **arguments: Any) -> None:
        """Take settings of `fgrecon.reconstruct`: prior, size_prior, options."""
        self._arguments = arguments
        self._tracks: dict[int, list[VehicleEstimate]] = {}
        self.refused = {}

    def update(
        self,
        time: float,
        observations: Mapping[int, Observation],
        *,
        camera: Camera,
        world_T_camera: Array | None = None,
        ground: Ground | None = None,
        motion_covariance: Array | None = None,  # noqa: ARG002 - one image knows of no motion
        evidence: Sequence[Evidence] = (),
        estimated: bool = True,  # noqa: ARG002 - nor of frames to come
    ) -> Mapping[int, VehicleEstimate]:
        """The estimates of the vehicles that can be reconstructed, by id."""
        estimates: dict[int, VehicleEstimate] = {}
        refused: dict[int, FgreconError] = {}
        for identity, observation in observations.items():
            try:
                result = reconstruct(observation, camera, ground=ground, evidence=evidence, **self._arguments)
            except FgreconError as error:
                refused[identity] = error
                continue
            pose = result.camera_T_object
            estimates[identity] = VehicleEstimate(
                id=identity,
                time=time,
                reconstruction=result,
                velocity=None,
                turn_rate=None,
                facing_probability=result.facing_probability,
                world_T_object=None if world_T_camera is None else world_T_camera @ pose,
            )
            self._tracks.setdefault(identity, []).append(estimates[identity])
        self.refused = refused
        return estimates

    def placed(self, vehicle: int) -> tuple[Array, Array] | None:
        """Pose (4, 4) of a vehicle in its last image, and its keypoints (K, 3) in its own; None of one without."""
        if vehicle not in self._tracks:
            return None
        last = self._tracks[vehicle][-1].reconstruction
        return last.camera_T_object, last.wireframe

    def forget(self, vehicle: int) -> None:
        """Let go of a vehicle's estimates; one that is not there is none to let go of."""
        self._tracks.pop(vehicle, None)

    def smooth(self) -> Mapping[int, Sequence[VehicleEstimate]]:
        """The same estimates once more."""
        return self._tracks
