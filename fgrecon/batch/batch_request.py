"""The service behind `fgrecon batch`: files of many vehicles into a folder of Parquet, by one request."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from fgrecon.batch.inputs import sources_of
from fgrecon.batch.parts import write_table
from fgrecon.batch.reconstructor import Reconstructor
from fgrecon.batch.runs import Tally, run
from fgrecon.core.camera import Camera
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.cameras.camera_source import CameraSource
from fgrecon.io.export.formats import TABLE_FORMATS
from fgrecon.io.files import check_ending, check_output
from fgrecon.io.keypoints.names import parse_names
from fgrecon.io.run_settings import RunSettings, camera_to_dict, content_hash, settings_to_dict
from fgrecon.perception.boxes import GivenBoxes
from fgrecon.perception.sensor_source import SensorSource


@dataclass(frozen=True)
class BatchRequest:
    """What is requested of many files."""

    inputs: Sequence[Path]  # files of keypoints, images, videos, or folders of them
    out: Path  # folder of the parts, made where it does not exist
    settings: RunSettings  # what holds for every vehicle
    camera: CameraSource = field(default_factory=CameraSource)  # the given camera; without one each row brings its own
    # what the keypoints are called, as `fgrecon.keypoints_from` takes it; None where they say it
    names: str | None = None
    weights: Path | None = None  # keypoint network, or None for the shipped one
    jobs: int = 1  # processes here, or actors at most on Ray
    ray: str | None = None  # address of a Ray cluster, or `auto`; None for processes of this machine
    every: int = 1  # of videos every so many frames
    batch_rows: int | None = None  # rows that a worker gets at once, or None
    sensors: SensorSource | None = None  # other sensors' files of images, or None
    # boxes of images' cars; without a file the detector looks for them
    boxes: GivenBoxes = field(default_factory=GivenBoxes)
    table: Path | None = None  # file that gets all rows of the folder as one table (csv, parquet), or None


def reconstruct_files(request: BatchRequest, report: Callable[[Tally], None] = lambda _: None) -> Tally:
    """Reconstruct every row of some files; see `fgrecon.batch.run`, whose errors it raises.

    Raises:
        InvalidInputError: The camera is given of a part of an image, but not that of the whole image; there are boxes
            but no images; or the table cannot be written.
    """
    if request.table is not None:
        check_ending(request.table, TABLE_FORMATS)
        check_output(request.table)
    sources = sources_of(request.inputs, request.every, request.settings.prior.category)
    if request.boxes != GivenBoxes() and not any(source.is_picture for source in sources):
        boxes = request.boxes.file or request.boxes.least_score
        raise InvalidInputError("boxes", str(boxes), "Give images or videos: keypoint files have boxes of their own.")
    request.boxes.check_images(len(sources))
    if (folder := _calibrations(request.camera)) is not None:
        sources = [replace(source, calib=folder) for source in sources]
    camera = _camera(request.camera)
    reconstructor = _reconstructor(request, camera)
    tally = run(
        sources,
        request.out,
        reconstructor,
        jobs=request.jobs,
        ray=request.ray,
        batch_rows=request.batch_rows,
        settings=_settings(request, camera),
        report=report,
    )
    if request.table is not None:
        write_table(request.out, request.table)
    return tally


def _camera(source: CameraSource) -> Camera | None:
    """The camera of all rows, or None; a folder of calibrations has one for each image."""
    camera = None if _calibrations(source) is not None else source.camera()[0]
    if camera is None and source.crop is not None:
        value = f"{source.crop.left:g},{source.crop.top:g}"
        raise InvalidInputError("crop", value, "Give the whole image's camera too (--camera, --intrinsics).")
    return None if camera is None else source.complete(camera, declared=False)


def _calibrations(source: CameraSource) -> Path | None:
    """The folder with a calibration for each image, or None."""
    return source.calib if source.calib is not None and source.calib.is_dir() else None


def _reconstructor(request: BatchRequest, camera: Camera | None) -> Reconstructor:
    settings = request.settings
    return Reconstructor(
        prior=settings.prior if settings.prior_file else settings.prior.name,
        camera=camera,
        ground=settings.ground,
        size_prior=settings.size_prior,
        options=settings.options,
        names=None if request.names is None else parse_names(request.names, settings.prior.category),
        weights=request.weights,
        threads=1,
        scale_to_image=request.camera.scale_to_image,
        sensors=request.sensors,
        boxes=request.boxes,
        classes=settings.classes,
    )


def _settings(request: BatchRequest, camera: Camera | None) -> dict[str, Any]:
    """What the folder's rows depend on."""
    settings, boxes = request.settings, request.boxes
    kept = settings_to_dict(settings) | {
        "camera": None if camera is None else camera_to_dict(camera),
        "weights": None if request.weights is None else str(request.weights),
        **({} if request.names is None else {"names": request.names}),
        **({"scale_to_image": True} if request.camera.scale_to_image else {}),
        **({} if request.sensors is None else {"sensors": request.sensors.to_dict()}),
        **({} if (folder := _calibrations(request.camera)) is None else {"calib": str(folder.absolute())}),
        **({} if boxes.file is None else {"boxes_file": str(boxes.file.absolute())}),
        **({} if boxes.least_score is None else {"min_score": boxes.least_score}),
    }
    files = {"prior": settings.prior_file, "weights": request.weights, "names": request.names, "boxes": boxes.file}
    for name, file in files.items():
        if (content := content_hash(None if file is None else Path(file))) is not None:
            kept[f"{name}_sha256"] = content
    return kept
