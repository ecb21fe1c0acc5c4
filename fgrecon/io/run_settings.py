"""Settings of a run for all vehicles: prior, ground, size and options; and as plain values for JSON."""

from __future__ import annotations

import os
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from fgrecon.core.camera import Camera, Ground
from fgrecon.core.choices import BoxModel, ClassSource
from fgrecon.core.options import BoxOptions, KeypointOptions, Options
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SizePrior
from fgrecon.io.catalogue import load_prior, load_size_prior, shipped_priors
from fgrecon.io.files import file_hash


@dataclass(frozen=True)
class RunSettings:
    """What holds for every vehicle of a run."""

    prior: ShapePrior
    ground: Ground | None  # the ground plane, or None
    size_prior: SizePrior | None  # how large vehicles are, or None
    options: Options  # how they are solved
    prior_file: Path | None = None  # where the prior is from; None for a shipped one
    classes: ClassSource | None = None  # who says of which class vehicles are; None where all are cars

    @classmethod
    def of(cls, prior: str, ground: Ground | None, size_prior: str | None, options: Options) -> RunSettings:
        """The settings with prior and fleet by name.

        Raises:
            InvalidInputError: A name is none of a prior, of a fleet or of a file.
        """
        return cls(
            prior=load_prior(prior),
            ground=ground,
            size_prior=None if size_prior is None else load_size_prior(size_prior),
            options=options,
            prior_file=None if prior in shipped_priors() else Path(prior).resolve(),
        )

    def arguments(self, box_model: BoxModel | None = None) -> dict[str, Any]:
        """Arguments of the solvers: prior, ground, size_prior and options, perhaps with another box model."""
        options = self.options
        if box_model is not None:
            options = replace(options, box=replace(options.box, model=box_model))
        return {"prior": self.prior, "ground": self.ground, "size_prior": self.size_prior, "options": options}


def settings_to_dict(settings: RunSettings) -> dict[str, Any]:
    """What held for all vehicles of a run, for JSON; with `prior_file` surfaces can be made again."""
    ground, size, options = settings.ground, settings.size_prior, settings.options
    return {
        "prior": settings.prior.name,
        "prior_file": None if settings.prior_file is None else str(settings.prior_file),
        "ground": None if ground is None else {"normal": ground.normal.tolist(), "distance": ground.distance},
        "size_prior": None
        if size is None
        else {"name": size.name, "mean": size.mean.tolist(), "sigma": size.sigma.tolist()},
        "strategy": options.strategy.name.value,
        "box_model": options.box.model.value,
        **({} if options.traffic is None else {"traffic": options.traffic.value}),
        **({} if settings.classes is None else {"classes": settings.classes.value}),
        **_changed("keypoints", options.keypoints, KeypointOptions()),
        **_changed("boxes", replace(options.box, model=BoxModel.SURFACE), BoxOptions()),
    }


def _changed(name: str, given: KeypointOptions | BoxOptions, default: KeypointOptions | BoxOptions) -> dict[str, Any]:
    """What is assumed of the keypoint detector, or of boxes, where that is not the default."""
    values = {entry.name: getattr(given, entry.name) for entry in fields(given)}
    changed = {entry: value for entry, value in values.items() if value != getattr(default, entry)}
    return {name: changed} if changed else {}


def camera_to_dict(camera: Camera) -> dict[str, Any]:
    """A camera for JSON."""
    return {
        "matrix": camera.matrix.tolist(),
        "distortion": None,
        **camera.lens_fields,
        "image_size": camera.image_size,
        **({"focal_sigma": camera.focal_sigma} if camera.focal_sigma else {}),
    }


def content_hash(path: Path | None) -> str | None:
    """The hash of a file's content; None for what is no file."""
    return file_hash(path) if path is not None and os.path.isfile(path) else None  # noqa: PTH113 - raises for no name
