"""The same result without the page: the request as a command and as Python."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path

from fgrecon.app.requested import PageRequested, Requested
from fgrecon.app.solving import Uploaded

_SWITCHES = {("together", "yes"): "--together", ("together", "no"): "--apart", ("history", "yes"): "--history"}
_OF_VIDEOS = ("--every", "--start", "--end")
_OPTIONS = {"strategy": "strategy", "box_model": "box", "traffic": "traffic"}


def as_command(requested: Requested, names: Uploaded) -> str:
    """The same on the command line, for files of these names."""
    files = {"camera": names.camera, "boxes": None if requested.box else names.boxes, "image": names.photograph}
    beside = [f"--{option}={name}" for option, name in files.items() if name]
    words = [word for word in _options(requested) if word.partition("=")[0] not in _OF_VIDEOS]
    return shlex.join(["fgrecon", "reconstruct", names.main, *beside, *words, "--json", "result.json"])


def as_video_command(requested: PageRequested, name: str) -> str:
    """The same of a video on the command line."""
    known = replace(requested, box=(), names="", min_score="", history="")
    return shlex.join(["fgrecon", "run", name, *_options(known), "--out", "results", "--video", "film.mp4"])


def _options(requested: Requested) -> list[str]:
    words = []
    for name, text in requested.items:
        if (name, text) in _SWITCHES:
            words.append(_SWITCHES[name, text])
        elif name not in ("together", "history"):
            words.append(f"--{name.replace('_', '-')}={text}")
    return words


def as_code(requested: Requested, names: Uploaded) -> str:
    """The same in Python, for a photograph or a keypoint file of that name."""
    given = dict(requested.items)
    arguments = {}
    if requested.camera_height:
        arguments["ground"] = requested.camera_height
    elif requested.ground:
        *normal, distance = requested.ground.split(",")
        arguments["ground"] = (
            f"fgrecon.Ground([{', '.join(normal)}], {distance})" if normal else f"fgrecon.Ground.of_height({distance})"
        )
    arguments |= {name: repr(given[name]) for name in ("size_prior", "prior") if name in given}
    options = [f"{theirs}={given[ours]!r}" for ours, theirs in _OPTIONS.items() if ours in given]
    if requested.min_confidence:
        options.append(f"keypoints=fgrecon.KeypointOptions(least_confidence={requested.min_confidence})")
    if options:
        arguments["options"] = f"fgrecon.Options({', '.join(options)})"
    return (_of_image if names.of_image else _of_keypoints)(requested, names, arguments)


def _of_image(requested: Requested, names: Uploaded, arguments: dict[str, str]) -> str:
    imports, before = ["import fgrecon"], ""
    if requested.box:
        arguments["boxes"] = f"[{', '.join(f'({box})' for box in requested.box)}]"
    elif names.boxes:
        imports.append("from fgrecon.io.boxes import boxes_in")
        before = f"found = boxes_in({names.boxes!r}, {Path(names.main).stem!r})\n"
        arguments["boxes"] = "[box.corners for box in found.cars]"
    if requested.together:
        arguments["together"] = str(requested.together == "yes")
    camera = _camera(requested, names, "None", imports)
    call = f"fgrecon.reconstruct_image({names.main!r}, {camera}{_more(arguments)})"
    head = "\n".join(imports)
    return f"{head}\n\n{before}for car in {call}:\n    print(car)\n"


def _of_keypoints(requested: Requested, names: Uploaded, arguments: dict[str, str]) -> str:
    called = f", names={requested.names!r}" if requested.names else ""
    imports = ["import json", "from pathlib import Path", "", "import fgrecon"]
    camera = _camera(requested, names, "car.camera", imports)
    head = "\n".join(imports)
    return (
        f"{head}\n\n"
        f"for car in fgrecon.keypoints_from(json.loads(Path({names.main!r}).read_text()){called}):\n"
        f"    print(fgrecon.reconstruct(car.observation, {camera}{_more(arguments)}))\n"
    )


def _camera(requested: Requested, names: Uploaded, other: str, imports: list[str]) -> str:
    if requested.intrinsics:
        lens = f", [{requested.distortion}]" if requested.distortion else ""
        return f"fgrecon.Camera.of(({requested.intrinsics}){lens})"
    if names.camera is None:
        return other
    imports.append("from fgrecon.io.cameras.camera_source import CameraSource")
    return f"CameraSource(file={names.camera!r}).camera({names.main!r})[0]"


def _more(arguments: dict[str, str]) -> str:
    return "".join(f", {name}={text}" for name, text in arguments.items())
