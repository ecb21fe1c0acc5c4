"""Settings of a solve from a query or a form, by the names of `fgrecon reconstruct`'s options."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, fields
from typing import Any, Self
from urllib.parse import urlencode

from fgrecon.core.choices import BoxModel, StrategyName, TrafficSide
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.options import KeypointOptions, Options
from fgrecon.core.parsing import parse_ground, parse_numbers
from fgrecon.core.size_prior import SIZE_PRIORS, size_prior
from fgrecon.io.cameras.camera_source import CameraSource
from fgrecon.io.catalogue import load_prior, shipped_priors
from fgrecon.io.keypoints.names import shipped_schemes
from fgrecon.io.run_settings import RunSettings

_MOST = 1e6  # frames, or seconds, of a video


def _entry(words: str, choices: Iterable[str] = ()) -> Any:
    """A field that is not given, with what it means and, where they are few, the texts that it can be."""
    return field(default="", metadata={"words": words, "choices": tuple(choices)})


@dataclass(frozen=True)
class Requested:
    """What is requested; every entry is a text, and empty where it is not given. Names are those of options.

    Nothing here names a file: priors, fleets and schemes are those that come with fgrecon.
    """

    intrinsics: str = _entry("Camera: fx,fy,cx,cy in pixels.")
    distortion: str = _entry("OpenCV's 4, 5, 8, 12 or 14 distortion coefficients.")
    camera_height: str = _entry("Height of a level camera above the ground, metres.")
    ground: str = _entry("Ground plane instead: nx,ny,nz,d, or the height alone of a tilted camera.")
    size_prior: str = _entry(
        f"How large vehicles are: {', '.join(SIZE_PRIORS)}, or length,width,height[,their spreads] in metres."
    )
    traffic: str = _entry("Side of the road that traffic keeps to.", TrafficSide)
    box: tuple[str, ...] = field(
        default=(), metadata={"words": "2D box x1,y1,x2,y2 of a car's outline in an image, pixels; may be repeated."}
    )
    min_score: str = _entry("Boxes of a lower score are left out, 0 to 1.")
    box_model: str = _entry("What 2D boxes enclose.", BoxModel)
    min_confidence: str = _entry("Keypoints of less confidence count as not measured, 0 to 1.")
    strategy: str = _entry("Robust strategy.", StrategyName)
    prior: str = _entry("Shape prior.", shipped_priors())
    names: str = _entry("What the keypoints of a file are called.", shipped_schemes())
    together: str = _entry("Whether the vehicles of an image share its ground.", ("yes", "no"))
    history: str = _entry("Whether results keep every step of the optimisation and its graph.", ("yes", "no"))

    @classmethod
    def of(cls, items: Iterable[tuple[str, str]]) -> Self:
        """From the items of a query."""
        given: dict[str, Any] = {}
        known = {entry.name: entry for entry in fields(cls)}
        for name, text in items:
            if name not in known:
                raise InvalidInputError(name, text, f"Give one of {', '.join(known)}.")
            choices = known[name].metadata.get("choices", ())
            if choices and text and text not in choices:
                raise InvalidInputError(name, text, f"Give one of {', '.join(choices)}.")
            if name == "box":
                given[name] = (*given.get(name, ()), text)
            elif name in given:
                raise InvalidInputError(name, text, "Give it once.")
            else:
                given[name] = text
        return cls(**given)

    @property
    def items(self) -> list[tuple[str, str]]:
        """What is given, by name."""
        pairs = [(entry.name, getattr(self, entry.name)) for entry in fields(self)]
        return [
            (name, text) for name, value in pairs for text in (value if isinstance(value, tuple) else (value,)) if text
        ]

    @property
    def query(self) -> str:
        """The items as the query of a link."""
        return urlencode(self.items)

    @property
    def keeps_history(self) -> bool:
        """Whether results keep their steps."""
        return self.history == "yes"

    def source(self) -> CameraSource:
        """What is given of the camera."""
        counts = (4, 5, 8, 12, 14)
        return CameraSource(
            intrinsics=self._numbers("intrinsics", "fx,fy,cx,cy: four numbers in pixels", (4,)),
            distortion=self._numbers("distortion", "4, 5, 8, 12 or 14 numbers in OpenCV's order", counts),
        )

    def boxes(self) -> list[list[float]]:
        """(N, 4) the given boxes."""
        return [parse_numbers("box", text, "x1,y1,x2,y2: four numbers in pixels", (4,)) for text in self.box]

    def number(self, name: str, lowest: float = 0.0, highest: float = 1.0) -> float | None:
        """An entry that is a number; None where it is not given."""
        text = getattr(self, name)
        if not text:
            return None
        (value,) = parse_numbers(name, text, "a number", (1,))
        if not lowest <= value <= highest:
            wanted = f"from {lowest:g} to {highest:g}" if highest < math.inf else f"of at least {lowest:g}"
            raise InvalidInputError(name, text, f"Give a finite number {wanted}.")
        return value

    def settings(self, *, history: bool | None = None) -> RunSettings:
        """What holds for every vehicle; steps are kept where that is said, else as requested."""
        height = self.number("camera_height", 0.0, math.inf)
        plane = parse_ground(self.ground or None, height)
        options = Options(
            strategy=self.strategy or StrategyName.MIXTURE,
            box=self.given_box_model or BoxModel.SURFACE,
            traffic=TrafficSide(self.traffic) if self.traffic else None,
            keypoints=KeypointOptions(least_confidence=self.number("min_confidence") or 0.0),
            keep_history=self.keeps_history if history is None else history,
        )
        return RunSettings(
            prior=load_prior(self.prior or "car14"),
            ground=None if plane is None else plane[0],
            size_prior=size_prior(self.size_prior) if self.size_prior else None,
            options=options,
        )

    @property
    def given_box_model(self) -> BoxModel | None:
        """What boxes enclose, where that is said."""
        return BoxModel(self.box_model) if self.box_model else None

    def _numbers(self, name: str, expected: str, counts: tuple[int, ...]) -> list[float] | None:
        text = getattr(self, name)
        return parse_numbers(name, text, expected, counts) if text else None


@dataclass(frozen=True)
class PageRequested(Requested):
    """What is requested of the page: of a video also which frames are taken."""

    every: str = _entry("Take every so many frames.")
    start: str = _entry("Begin so many seconds after the first frame.")
    end: str = _entry("End so many seconds after the first frame.")

    def frames(self) -> dict[str, Any]:
        """Which frames of a video are taken, as `fgrecon.video.video_job.VideoRequest` has it."""
        every = self.number("every", 1.0, _MOST)
        if every is not None and every != round(every):
            raise InvalidInputError("every", self.every, "Give a whole number.")
        start, end = self.number("start", 0.0, _MOST), self.number("end", 0.0, _MOST)
        return {"every": int(every or 1), "start": start or 0.0, "end": end}
