"""What is requested as a command and as Python: the same result without the page."""

from __future__ import annotations

import shlex

from fgrecon.app.requested import Requested

_SWITCHES = {("together", "yes"): "--together", ("together", "no"): "--apart", ("history", "yes"): "--history"}
_OPTIONS = {"strategy": "strategy", "box_model": "box", "traffic": "traffic"}


def as_command(requested: Requested, file: str) -> str:
    """The same on the command line, for a file of that name."""
    words = ["fgrecon", "reconstruct", file]
    for name, text in requested.items:
        if name not in ("together", "history"):
            words.append(f"--{name.replace('_', '-')}={text}")
        elif (name, text) in _SWITCHES:
            words.append(_SWITCHES[name, text])
    return shlex.join([*words, "--json", "result.json"])


def as_code(requested: Requested, file: str, *, of_image: bool) -> str:
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
    return _of_image(requested, file, arguments) if of_image else _of_keypoints(requested, file, arguments)


def _of_image(requested: Requested, file: str, arguments: dict[str, str]) -> str:
    if requested.box:
        arguments["boxes"] = f"[{', '.join(f'({box})' for box in requested.box)}]"
    if requested.together:
        arguments["together"] = str(requested.together == "yes")
    camera = _camera(requested, "None")
    call = f"fgrecon.reconstruct_image({file!r}, {camera}{_more(arguments)})"
    return f"import fgrecon\n\nfor car in {call}:\n    print(car)\n"


def _of_keypoints(requested: Requested, file: str, arguments: dict[str, str]) -> str:
    names = f", names={requested.names!r}" if requested.names else ""
    camera = _camera(requested, "car.camera")
    return (
        "import json\nfrom pathlib import Path\n\nimport fgrecon\n\n"
        f"for car in fgrecon.keypoints_from(json.loads(Path({file!r}).read_text()){names}):\n"
        f"    print(fgrecon.reconstruct(car.observation, {camera}{_more(arguments)}))\n"
    )


def _camera(requested: Requested, other: str) -> str:
    if not requested.intrinsics:
        return other
    lens = f", [{requested.distortion}]" if requested.distortion else ""
    return f"fgrecon.Camera.of(({requested.intrinsics}){lens})"


def _more(arguments: dict[str, str]) -> str:
    return "".join(f", {name}={text}" for name, text in arguments.items())
