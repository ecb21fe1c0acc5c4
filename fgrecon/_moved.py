"""Where modules of the first release are now: importing them by their old names works for one more release.

Only modules are listed; a name that has gone to another module than its neighbours is imported there by the new module.
"""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Sequence
from importlib.machinery import ModuleSpec
from types import ModuleType

__all__ = ["MOVED", "MovedFinder"]

_ROOMS = {
    "core": "camera category checks observation options reconstruction robust",
    "io": "catalogue files images json_fields keypoint_file",
    "simulation": "demo keypoint_noise render scenery",
    "solve": "pipeline result track",
}
_PACKAGES = {
    "pose": "solve.proposals",
    "shape": "solve.graph",
    "keypoints": "perception.keypoints",
    "vehicles": "perception.vehicles",
    "annotations": "io.annotations",
    "export": "io.export",
    "priors": "training.priors",
}
_MEMBERS = {
    "annotations": "annotations coco npz offsets pascal3d reader veri36",
    "export": "files kitti mesh results table",
    "keypoints": "crops decode detect knet refine weights",
    "pose": "adjust aspnp irls problem search starts terms",
    "priors": "apollo79 canonical_frame compare em_ppca factorisation learn nrsfm nrsfm_options pca ppca",
    "shape": "adjust covariance graph solver structure",
    "vehicles": "detect",
}
_ELSEWHERE = {
    "boxes": "perception.boxes",
    "evaluation.apollocar3d": "paper.apollocar3d",
    "evaluation.kitti_files": "io.kitti_files",
    "evaluation.metrics": "core.metrics",
    "evaluation.paper": "paper.run",
    "evaluation.processes": "core.processes",
    "evaluation.shape": "paper.shape",
    "evaluation.simulated": "paper.simulated",
    "evaluation.tracks": "io.track_file",
    "from_image": "perception.from_image",
    "keypoints.evaluate": "training.keypoints.evaluate",
    "keypoints.posed_cars": "training.keypoints.posed_cars",
    "keypoints.rounds": "training.keypoints.rounds",
    "keypoints.train": "training.keypoints.train",
    "kitti": "io.kitti_calibration",
    "model": "solve.vehicle.model",
    "pose.geometry": "core.geometry",
    "pose.visibility": "solve.vehicle.visibility",
    "priors.conditioning": "solve.vehicle.conditioning",
    "priors.icra2017": "paper.icra2017_release",
    "priors.shape_prior": "core.shape_prior",
    "priors.size_prior": "core.size_prior",
    "replay": "viz.replay",
    "simulate": "simulation.vehicles",
    "vehicles.darknet": "training.keypoints.darknet",
}


def _table() -> dict[str, str]:
    table = {name: f"{room}.{name}" for room, names in _ROOMS.items() for name in names.split()}
    table |= _PACKAGES
    for package, names in _MEMBERS.items():
        table |= {f"{package}.{name}": f"{_PACKAGES[package]}.{name}" for name in names.split()}
    return {f"fgrecon.{old}": f"fgrecon.{new}" for old, new in {**table, **_ELSEWHERE}.items()}


MOVED = _table()
"""New name of each module that has moved, by its old one."""


class MovedFinder:  # a finder and loader by its methods: `importlib.abc` takes half as long to import as fgrecon
    """Finds modules that have moved, and warns (`DeprecationWarning`) where they are now."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """The spec of a module by its old name; None for every other one."""
        del path, target
        return ModuleSpec(fullname, self) if fullname in MOVED else None  # type: ignore[arg-type]

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """The module itself, imported by its new name."""
        new = MOVED[spec.name]
        message = f"{spec.name} is now {new}; the old name goes with the next release."
        warnings.warn(message, DeprecationWarning, stacklevel=2)
        module = importlib.import_module(new)
        self._spec = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Nothing is executed twice; the module keeps the spec of its new name."""
        module.__spec__ = self._spec
