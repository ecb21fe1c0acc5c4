"""Budgets of the code: the lines of what users install, and the way of the keypoints through `fgrecon.reconstruct`.

    python -m benchmarks.budgets

Lines are those of `.py`, `.pyx` and `.pxd` files that Git knows, comments and docstrings included.

The way is traced by `sys.setprofile` while one made-up car, of a camera with a distorted lens, is reconstructed, up to
the graph, whose factors have the keypoints inside. Keypoints are the arrays that are given; an `Observation`, a
`Problem` or a `PoseEnergy`; and, as a reader of the code has to follow them, whatever a function that was handed
keypoints returns, or makes and hands on. Every function counts where it is entered first; properties are no calls. A
*place* is a stay in a file: one place as long as the calls that follow are in one file, another one where a file is
come back to. They go *back up* where the room of a place is further down in the table of
`docs/reference/rooms.md`, which begins at the bottom, than that of the place before. `--way` prints the
places. It is the way through
the compiled kernels: what they do is one place, and their numpy versions go through more. So measured they passed 38
places and went back up 9 times when the budgets were set; a static walk, which follows branches that are not taken as
well, had found 47 and 11.

Prints a table; exits with 1 where a budget is exceeded.
"""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import dataclass, field
from functools import cached_property
from inspect import getattr_static
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import numpy as np

import fgrecon
from fgrecon.core.observation import Observation
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.proposals.search import PoseEnergy

REPOSITORY = Path(__file__).resolve().parents[1]
_CARRIERS = Observation, Problem, PoseEnergy


@dataclass(frozen=True)
class Budget:
    """What is counted, how much there is, and how much there may be."""

    name: str
    count: int
    most: int


def lines_of(*folders: str) -> int:
    """Lines of the Python and Cython files in folders of the repository."""
    patterns = [f"{folder}/{ending}" for folder in folders for ending in ("*.py", "*.pyx", "*.pxd")]
    listed = subprocess.run(["git", "ls-files", *patterns], cwd=REPOSITORY, capture_output=True, text=True, check=True)
    files = [REPOSITORY / name for name in listed.stdout.splitlines()]
    return sum(file.read_bytes().count(b"\n") for file in files if file.exists())


def line_budgets() -> list[Budget]:
    """Those of lines: of what users install, of research, and of the command line."""
    return [
        Budget("lines of fgrecon and factors", lines_of("fgrecon", "factors"), 40_000),
        Budget("lines of research", lines_of("research/fgrecon_research"), 18_000),
        Budget("lines of fgrecon/cli", lines_of("fgrecon/cli"), 5_500),
    ]


def rooms() -> dict[str, int]:
    """Place of each room in the layer table, from the bottom."""
    table = (REPOSITORY / "docs/reference/rooms.md").read_text(encoding="utf-8").partition("| room |")[2]
    names = re.findall(r"^\| (?:`([\w/]+)`|\(public names\)) \|", table.partition("\n\n")[0], re.MULTILINE)
    return {name: height for height, name in enumerate(names)}


@dataclass
class Tracer:
    """Follows keypoints from function to function.

    Attributes:
        places: The files, in the order in which they are entered, and the functions there.
    """

    places: list[tuple[str, list[str]]] = field(default_factory=list)
    _keypoints: dict[int, object] = field(default_factory=dict)  # by identity, and kept so that none is used twice
    _following: set[int] = field(default_factory=set)  # frames that were handed keypoints
    _passed: set[CodeType] = field(default_factory=set)
    _ended: bool = False

    def follow(self, given: np.ndarray[Any, Any], **arguments: Any) -> None:
        """Reconstruct a car from its keypoints."""
        self._keep(given)
        sys.setprofile(self._event)
        try:
            fgrecon.reconstruct(given, **arguments)
        finally:
            sys.setprofile(None)

    def _event(self, frame: FrameType, event: str, returned: object) -> None:
        code = frame.f_code
        if event == "return" and id(frame) in self._following:
            self._following.discard(id(frame))
            self._keep(returned)
        file = Path(code.co_filename)
        if event != "call" or self._ended or code.co_name.startswith("<") or not file.is_relative_to(REPOSITORY):
            return
        name = file.relative_to(REPOSITORY).as_posix()
        self._ended = name.startswith("fgrecon/solve/graph/")
        if self._ended or not name.startswith(("fgrecon/", "factors/")) or _is_property(frame):
            return
        if any(self._are_keypoints(value, frame.f_back) for value in _arguments(frame)):
            self._following.add(id(frame))
            if code not in self._passed:
                self._passed.add(code)
                if not self.places or self.places[-1][0] != name:
                    self.places.append((name, []))
                self.places[-1][1].append(code.co_name)

    def _keep(self, value: object) -> None:
        for one in value if isinstance(value, list | tuple) else [value]:
            if _is_data(one):
                self._keypoints[id(_owner(one))] = _owner(one)

    def _are_keypoints(self, value: object, caller: FrameType | None) -> bool:
        if isinstance(value, list | tuple):
            return any(self._are_keypoints(one, caller) for one in value)
        if isinstance(value, _CARRIERS) or id(_owner(value)) in self._keypoints:
            return True
        if caller is None or id(caller) not in self._following or not _is_data(value):
            return False
        others = [*_arguments(caller), *caller.f_globals.values()]  # what the caller has not made
        return not any(value is other for other in others)

    @property
    def climbs(self) -> list[tuple[str, str]]:
        """The places that stand above the one before, with that."""
        heights = rooms()
        files = [file for file, _ in self.places]
        room = [str(Path(file).parent).removeprefix("fgrecon/") for file in files]
        pairs = zip(files, files[1:], room, room[1:], strict=False)
        return [(first, second) for first, second, low, high in pairs if heights[high] > heights[low]]


def _arguments(frame: FrameType) -> list[object]:
    code = frame.f_code
    return [frame.f_locals.get(name) for name in code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]]


def _owner(value: object) -> object:
    """The array whose memory an array shows; anything else itself."""
    return value.base if isinstance(value, np.ndarray) and isinstance(value.base, np.ndarray) else value


def _is_data(value: object) -> bool:
    """Whether a value is an array, or an object of fgrecon or factors."""
    return isinstance(value, np.ndarray) or type(value).__module__.startswith(("fgrecon", "factors"))


def _is_property(frame: FrameType) -> bool:
    found: Any = sys.modules.get(frame.f_globals["__name__"])
    for name in frame.f_code.co_qualname.split("."):
        found = getattr_static(found, name, None)
    return isinstance(found, property | cached_property)


def traced() -> Tracer:
    """The way of a made-up car's keypoints."""
    prior = fgrecon.load_prior("car14")
    camera = fgrecon.Camera(np.array([[720.0, 0.0, 610.0], [0.0, 720.0, 175.0], [0.0, 0.0, 1.0]]))
    lens = fgrecon.Camera(camera.matrix, np.array([-0.05, 0.01, 0.0, 0.0, 0.0]))
    turn = np.array([[0.8, 0.0, 0.6], [0.0, 1.0, 0.0], [-0.6, 0.0, 0.8]])
    pixels = lens.distort(camera.project(prior.mean @ turn.T + np.array([1.5, 1.65, 12.0])))
    box = np.concatenate([pixels.min(axis=0) - 5.0, pixels.max(axis=0) + 5.0])
    arguments: dict[str, Any] = {
        "intrinsics": lens,
        "confidence": np.full(len(pixels), 0.8),
        "box": box,
        "ground": 1.65,
    }
    fgrecon.reconstruct(pixels, **arguments)  # what is imported and remembered once is no part of the way
    tracer = Tracer()
    tracer.follow(pixels, **arguments)
    return tracer


def main() -> int:
    """Print the budgets; 1 where one is exceeded."""
    tracer = traced()
    for file, functions in tracer.places if "--way" in sys.argv else ():
        print(f"{file}: {', '.join(functions)}")
    budgets = [
        *line_budgets(),
        Budget("places that keypoints pass", len(tracer.places), 25),
        Budget("times that they go back up", len(tracer.climbs), 4),
    ]
    for budget in budgets:
        over = "" if budget.count <= budget.most else f"  {budget.count - budget.most:,} too many"
        print(f"{budget.name:<32}{budget.count:>8,} of {budget.most:>7,}{over}")
    return int(any(budget.count > budget.most for budget in budgets))


if __name__ == "__main__":
    sys.exit(main())
