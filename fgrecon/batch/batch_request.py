"""What `fgrecon batch` does: files of many vehicles into a folder of Parquet, by a request with everything in it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from fgrecon.batch.inputs import sources_of
from fgrecon.batch.reconstructor import Reconstructor
from fgrecon.batch.runs import Tally, run
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.cameras.camera_source import CameraSource
from fgrecon.io.keypoints.names import parse_names
from fgrecon.io.run_settings import RunSettings, camera_to_dict, content_hash, settings_to_dict
from fgrecon.perception.sensor_source import SensorSource


@dataclass(frozen=True)
class BatchRequest:
    """What is requested of many files.

    Attributes:
        inputs: Files of keypoints, images, videos, or folders of them.
        out: Folder of the parts, made where it does not exist.
        settings: What holds for every vehicle.
        camera: The given camera; without one each row brings its own.
        names: What the keypoints are called, as `fgrecon.keypoints_from` takes it; None where they say it.
        weights: Keypoint network, or None for the shipped one.
        jobs: Processes here, or actors at most on Ray.
        ray: Address of a Ray cluster, or `auto`; None for processes of this machine.
        every: Of videos every so many frames.
        batch_rows: Rows that a worker gets at once, or None.
        sensors: Other sensors' files of images, or None.
    """

    inputs: Sequence[Path]
    out: Path
    settings: RunSettings
    camera: CameraSource = field(default_factory=CameraSource)
    names: str | None = None
    weights: Path | None = None
    jobs: int = 1
    ray: str | None = None
    every: int = 1
    batch_rows: int | None = None
    sensors: SensorSource | None = None


def reconstruct_files(request: BatchRequest, report: Callable[[Tally], None] = lambda _: None) -> Tally:
    """Reconstruct every row of some files; see `fgrecon.batch.run`, whose errors it raises.

    Args:
        request: What is requested.
        report: Called whenever rows are done.

    Raises:
        InvalidInputError: The camera is given of a part of an image, but not that of the whole image.
    """
    settings, source = request.settings, request.camera
    camera = source.camera()[0]
    if camera is None and source.crop is not None:
        value = f"{source.crop.left:g},{source.crop.top:g}"
        raise InvalidInputError("crop", value, "Give the whole image's camera too (--camera, --intrinsics).")
    camera = None if camera is None else source.complete(camera, declared=False)
    reconstructor = Reconstructor(
        prior=settings.prior if settings.prior_file else settings.prior.name,
        camera=camera,
        ground=settings.ground,
        size_prior=settings.size_prior,
        options=settings.options,
        names=None if request.names is None else parse_names(request.names, settings.prior.category),
        weights=request.weights,
        threads=1,
        scale_to_image=source.scale_to_image,
        sensors=request.sensors,
    )
    folder_of = settings_to_dict(settings) | {
        "camera": None if camera is None else camera_to_dict(camera),
        "weights": None if request.weights is None else str(request.weights),
        **({} if request.names is None else {"names": request.names}),
        **({"scale_to_image": True} if source.scale_to_image else {}),
        **({} if request.sensors is None else {"sensors": request.sensors.to_dict()}),
    }
    for name, file in (("prior", settings.prior_file), ("weights", request.weights), ("names", request.names)):
        if (content := content_hash(None if file is None else Path(file))) is not None:
            folder_of[f"{name}_sha256"] = content
    return run(
        sources_of(request.inputs, request.every, settings.prior.category),
        request.out,
        reconstructor,
        jobs=request.jobs,
        ray=request.ray,
        batch_rows=request.batch_rows,
        settings=folder_of,
        report=report,
    )
