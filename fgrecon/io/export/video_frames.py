"""The results of a video's run as results by name, with the time of each frame and where its camera was."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from fgrecon.core.checks import as_finite
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.serialise import well_formed
from fgrecon.io.export.formats import check_format
from fgrecon.io.export.image_info import ImageInfo, info_of, names_of
from fgrecon.io.export.results import NamedResult, ground_of
from fgrecon.io.json_fields import parse_json

_FILE = "frames.jsonl"
FRAME_FORMAT = "fgrecon.video-frame/1"
_NOT_OF_VIDEOS = frozenset(["ply", "glb", "csv", "parquet", "kitti", "cityscapes3d", "labelme", "supervisely"])
_OF_SIZE = frozenset(["label_studio", "scalabel", "datumaro", "fiftyone"])  # of images, which frames do not keep


def frames_file(path: Path) -> Path | None:
    """The frames' file of a folder that `fgrecon run` wrote, or that file itself; None for other results."""
    if path.is_dir():
        return path / _FILE if (path / _FILE).is_file() else None
    return path if path.suffix.lower() == ".jsonl" else None


def check_video_format(path: Path, kind: str | None = None) -> None:
    """Refuse kinds of files that do not tell frames apart.

    Args:
        kind: One of `KINDS`, or None for what the ending says.
    """
    if (found := check_format(path, kind)) in _NOT_OF_VIDEOS | _OF_SIZE:
        fix = (
            f"`fgrecon run` has written tracks.csv, tracks.parquet, tracks.txt (KITTI's tracking) and {_FILE} there. "
            "Give .mcap, .json, .feather or .bin for another file, --format tum or kitti_poses for the camera's path."
        )
        raise InvalidInputError("format", f"{found} for a video", fix)


def read_video_frames(
    path: Path, images: Mapping[str, ImageInfo] | None = None
) -> tuple[list[NamedResult], dict[str, ImageInfo]]:
    """The vehicles of all frames, those that were refused left out, and what is known of the frames.

    Args:
        path: `frames.jsonl` of `fgrecon run`.
        images: What else is known of the frames, by their names; goes before the file.

    Returns:
        The vehicles, named by their ids and their frames as images; and by their names all frames, and what images
        there are beside them: samples between the frames of a run belong to its results.
    """
    results: list[NamedResult] = []
    infos: dict[str, ImageInfo] = {}
    try:
        with path.open("rb") as lines:  # a line that is not UTF-8 is malformed, as others are
            for number, line in enumerate(lines, start=1):
                with well_formed(f"{path}: line {number}", "Give the file as `fgrecon run` wrote it."):
                    _add(parse_json(line.decode()), results, infos)
    except OSError as error:
        raise InvalidInputError("file", str(path), f"Give a file that can be read ({error.strerror}).") from error
    given = images or {}
    own = {known for name in infos for known in names_of(name)}
    others = {name: info for name, info in given.items() if name not in own}
    return results, {name: _with(info, info_of(name, given)) for name, info in infos.items()} | others


def _add(frame: Any, results: list[NamedResult], infos: dict[str, ImageInfo]) -> None:
    if frame["format"] != FRAME_FORMAT:
        raise ValueError(f"format {frame['format']}")
    image, pose = str(frame["name"]), frame["world_T_camera"]
    placed = None if pose is None else as_finite("world_T_camera", pose, (4, 4))
    infos[image] = ImageInfo(timestamp=float(frame["time"]), world_T_camera=placed)
    for vehicle in frame["vehicles"]:
        if vehicle["result"] is not None:
            result, box = Reconstruction.from_dict(vehicle["result"]), as_finite("box", vehicle["box"], (4,))
            rest = {name: vehicle.get(name) for name in ("kind", "score")}
            if placed is not None and vehicle.get("velocity_x") is not None:
                rest["velocity"] = as_finite("velocity", [vehicle[f"velocity_{axis}"] for axis in "xyz"], (3,))
            results.append(NamedResult(str(vehicle["id"]), result, box, image=image, ground=ground_of(frame), **rest))


def _with(own: ImageInfo, given: ImageInfo) -> ImageInfo:
    """What is given of a frame, and where that says nothing what the run knows."""
    names = [field.name for field in fields(ImageInfo)]
    return ImageInfo(*(getattr(given, n) if getattr(given, n) is not None else getattr(own, n) for n in names))
