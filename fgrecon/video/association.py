"""Which detected vehicle is which of those seen before: gates, and scipy's assignment.

    boxes of tracks, predicted ----+
                                   +---- gates, costs ---- assignment ---- ids; births; re-births; deaths
    boxes of detections -----------+

A track predicts its box by how the box has moved and grown, or by the pose and velocity that it was told (`tell`), and
where it stands on the ground by how that has moved. A detection is a track's where the boxes overlap and the places
agree; the sum of 1 - overlap, of the places' deviation and of how little the directions that a network sees them from
have in common is least over all pairs. Sure detections choose first, then doubtful ones. A track that is not seen is
sought for a while, and has its id back when it is found again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import count
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import box_around, transform

__all__ = ["Association", "AssociationSettings", "Candidate", "GatedAssociation", "overlaps", "stands_at"]

Array = NDArray[np.float64]

_BOX_PIXELS = 3.0  # standard deviation of a box's lower edge
_PITCH = 0.004  # radians by which the camera pitches against the road from frame to frame
_AT_BORDER = 2.0  # pixels from the image's border, where a box is cut off
_NEW = 0.3  # share of a frame in what is remembered of a vehicle's directions
_NEVER = 1e6  # cost of what the gates refuse


@dataclass(frozen=True, eq=False)
class Candidate:
    """A detected vehicle.

    Attributes:
        box: (4,) x1, y1, x2, y2 in pixels.
        score: Of the detection, on the scale of `AssociationSettings.birth`.
        place: (3,) where it stands in the camera's frame, by its box (`stands_at`), metres; or None.
        spread: Standard deviation of that along the line of sight, metres.
        directions: (A,) probability of each direction that it is seen from (`Observation.azimuth`), or None.
    """

    box: Array
    score: float = 1.0
    place: Array | None = None
    spread: float = 1.0
    directions: Array | None = None


class Association(Protocol):
    """Gives ids to the vehicles of one frame after the other."""

    def __call__(
        self, time: float, candidates: Sequence[Candidate], previous_T_current: Array | None = None, /
    ) -> list[int | None]:
        """The id of each candidate; None for one that is not to be followed.

        Args:
            time: Seconds.
            candidates: What the frame shows.
            previous_T_current: (4, 4) motion of the camera since the frame before, or None.
        """

    def tell(self, identity: int, points: Array, velocity: Array, camera: Camera, /) -> None:
        """Take the estimate of a vehicle in the frame that was given last.

        Args:
            identity: The vehicle.
            points: (M, 3) points of it in the camera's frame, metres.
            velocity: (3,) seen from the camera, in its frame, metres per second.
            camera: The camera.
        """


@dataclass(frozen=True)
class AssociationSettings:
    """When a detection is a track's.

    Attributes:
        overlap: Least intersection over union of the boxes.
        deviation: Largest deviation of the places, standard deviations.
        birth: Least score with which a track begins; weaker detections only continue one. Minus infinity where scores
            are of an unknown scale.
        alive: Seconds that a track may go unseen and still be first to choose.
        memory: Seconds after which it is given up.
        place_weight: Cost of a deviation of the places at its gate, relative to boxes that do not overlap.
        direction_weight: Cost of directions that have nothing in common, likewise.
    """

    overlap: float = 0.25
    deviation: float = 3.0
    birth: float = 0.5
    alive: float = 0.35
    memory: float = 2.0
    place_weight: float = 0.5
    direction_weight: float = 1.0


@dataclass(frozen=True, eq=False)
class _Track:
    """What is remembered of a vehicle, at the time it was seen last; rates are per second."""

    time: float
    box: Array  # centre, log of width and height
    box_rate: Array
    place: Array | None
    place_rate: Array
    spread: float
    shift: Array = field(default_factory=lambda: np.zeros(4))  # of the box by the told motion
    told: bool = False
    directions: Array | None = None  # mean of the last ones, as in `Candidate`


@dataclass
class GatedAssociation:
    """`Association` by gates and the assignment of least cost.

    Attributes:
        settings: When a detection is a track's.
        first: The first id.
        given_up: Called with each id that is given up and never comes back; or None.
        deaths: How many tracks were given up.
        rebirths: How often a track that was not alive any more had its id back.
    """

    settings: AssociationSettings = field(default_factory=AssociationSettings)
    first: int = 0
    given_up: Callable[[int], None] | None = None
    deaths: int = field(default=0, init=False)
    rebirths: int = field(default=0, init=False)
    _tracks: dict[int, _Track] = field(default_factory=dict, init=False)
    _ids: count[int] = field(init=False)

    def __post_init__(self) -> None:
        """Begin to count."""
        self._ids = count(self.first)

    def __call__(
        self, time: float, candidates: Sequence[Candidate], previous_T_current: Array | None = None, /
    ) -> list[int | None]:
        """The id of each candidate; see `Association`."""
        if previous_T_current is not None:
            moved: Array = np.linalg.inv(previous_T_current).astype(np.float64)
            self._tracks = {i: _seen_from(moved, track) for i, track in self._tracks.items()}
        dead = [i for i, track in self._tracks.items() if time - track.time > self.settings.memory]
        self.deaths += len(dead)
        for identity in dead:
            del self._tracks[identity]
            if self.given_up is not None:
                self.given_up(identity)
        found: list[int | None] = [None] * len(candidates)
        alive = [i for i, track in self._tracks.items() if time - track.time <= self.settings.alive]
        lost = [i for i in self._tracks if i not in alive]
        sure = [place for place, candidate in enumerate(candidates) if candidate.score >= self.settings.birth]
        everything = list(range(len(candidates)))
        for group, places in ((alive, sure), (alive, everything), (lost, sure)):
            left = [identity for identity in group if identity not in found]
            free = [place for place in places if found[place] is None]
            for row, column in _assigned(self._costs(time, left, [candidates[i] for i in free])):
                found[free[column]] = left[row]
                self.rebirths += group is lost
        for place, candidate in enumerate(candidates):
            if found[place] is None and candidate.score >= self.settings.birth:
                found[place] = next(self._ids)
            if (known := found[place]) is not None:
                self._tracks[known] = _updated(self._tracks.get(known), time, candidate)
        return found

    def tell(self, identity: int, points: Array, velocity: Array, camera: Camera, /) -> None:
        """Take the estimate of a vehicle: from now on its box is predicted by its motion in space."""
        track = self._tracks.get(identity)
        if track is None:
            raise InvalidInputError("identity", identity, "Give the id of a vehicle of the frame before.")
        ahead = 0.1  # seconds: near enough for a rate, far enough for rounding
        later = points + ahead * velocity
        if not (points[:, 2].min() > 1.0 and later[:, 2].min() > 1.0):  # too near for a box of projections
            return
        now, then = (_as_state(box_around(camera.project(p))) for p in (points, later))
        self._tracks[identity] = replace(track, shift=(then - now) / ahead, told=True)

    def _costs(self, time: float, identities: Sequence[int], candidates: Sequence[Candidate]) -> Array:
        """(tracks, candidates) cost of every pair; `_NEVER` where a gate refuses it."""
        costs = np.full((len(identities), len(candidates)), _NEVER)
        if not costs.size:
            return costs
        tracks = [self._tracks[identity] for identity in identities]
        predicted = np.array([_as_box(_box_at(track, time)) for track in tracks])
        overlap = overlaps(predicted, np.array([c.box for c in candidates]))
        for row, track in enumerate(tracks):
            for column, candidate in enumerate(candidates):
                off = _deviation(track, candidate, time)
                if overlap[row, column] >= self.settings.overlap and off <= self.settings.deviation:
                    share = (off / self.settings.deviation) ** 2
                    turned = self.settings.direction_weight * _turned(track, candidate)
                    costs[row, column] = 1.0 - overlap[row, column] + self.settings.place_weight * share + turned
        return costs


def overlaps(first: Array, second: Array) -> Array:
    """(M, N) intersection over union of boxes (M, 4) and (N, 4)."""
    low = np.maximum(first[:, None, :2], second[None, :, :2])
    high = np.minimum(first[:, None, 2:], second[None, :, 2:])
    common = np.clip(high - low, 0.0, None).prod(axis=2)
    areas = [(boxes[:, 2:] - boxes[:, :2]).prod(axis=1) for boxes in (first, second)]
    union: Array = areas[0][:, None] + areas[1][None] - common
    return np.asarray(common / np.maximum(union, 1e-9))


def stands_at(box: Array, camera: Camera, ground: Ground) -> tuple[Array, float] | None:
    """Where the line of sight through the middle of a box's lower edge meets the ground, and how sure that is.

    Args:
        box: (4,) x1, y1, x2, y2 in pixels.
        camera: The camera.
        ground: The ground in its frame.

    Returns:
        (3,) the place in the camera's frame and its standard deviation along the line of sight from frame to frame,
        metres; None where the box is cut off by the image's lower border, or the line meets no ground.
    """
    if camera.image_size is not None and box[3] > camera.image_size[1] - 1 - _AT_BORDER:
        return None
    foot = np.array([[(box[0] + box[2]) / 2, box[3]], [(box[0] + box[2]) / 2, box[3] + _BOX_PIXELS]])
    rays = camera.rays(camera.undistort(foot))
    falls = rays @ ground.normal
    if falls[0] <= 1e-3:
        return None
    place, nearer = (ground.distance / fall * ray for ray, fall in zip(rays, falls, strict=True))
    pitched = float(_PITCH * place[2] / falls[0])
    return place, float(np.hypot(np.linalg.norm(place - nearer), pitched)) + 0.3


def _assigned(costs: Array) -> list[tuple[int, int]]:
    """Pairs of least total cost among those that the gates let pass."""
    from scipy.optimize import linear_sum_assignment

    if not costs.size:
        return []
    rows, columns = linear_sum_assignment(costs)
    return [(int(r), int(c)) for r, c in zip(rows, columns, strict=True) if costs[r, c] < _NEVER]


def _updated(track: _Track | None, time: float, candidate: Candidate) -> _Track:
    """The track with what it was seen as now."""
    box = _as_state(candidate.box)
    if track is None:
        still = np.zeros(4), candidate.place, np.zeros(3)
        return _Track(time, box, *still, candidate.spread, directions=candidate.directions)
    passed = max(time - track.time, 1e-3)
    rate = (box - track.box) / passed
    box_rate = 0.5 * track.box_rate + 0.5 * rate if track.box_rate.any() else rate
    place, place_rate = candidate.place, track.place_rate
    if place is not None and track.place is not None:
        guess = track.place + passed * place_rate
        off = place - guess
        place, place_rate = guess + 0.5 * off, place_rate + 0.15 * off / passed
    elif place is None and track.place is not None:
        place = track.place + passed * place_rate
    directions = track.directions if candidate.directions is None else candidate.directions
    if (both := _directions(track, candidate)) is not None:
        before, now = both
        directions = before + _NEW * (now - before)
    return _Track(time, box, box_rate, place, place_rate, candidate.spread, directions=directions)


def _seen_from(current_T_previous: Array, track: _Track) -> _Track:
    """The track's place after the camera has moved."""
    if track.place is None:
        return track
    turn = current_T_previous[:3, :3]
    place = transform(current_T_previous, track.place[None])[0]
    return replace(track, place=place, place_rate=turn @ track.place_rate)


def _box_at(track: _Track, time: float) -> Array:
    """The box's state, predicted: by its own rate, which soon says nothing more, or by the told motion."""
    passed = time - track.time
    rate = 0.5 * (track.shift + track.box_rate) if track.told else track.box_rate
    return track.box + rate * min(passed, 0.5)


def _deviation(track: _Track, candidate: Candidate, time: float) -> float:
    """How far a candidate stands from where the track should, standard deviations; 0 where one does not know."""
    if track.place is None or candidate.place is None:
        return 0.0
    passed = time - track.time
    off = float(np.linalg.norm(candidate.place - track.place - passed * track.place_rate))
    return off / float(np.hypot(np.hypot(track.spread, candidate.spread), 1.0 + 4.0 * passed))


def _turned(track: _Track, candidate: Candidate) -> float:
    """How little the directions of a candidate and of the track have in common, 0 to 1; 0 where one has none."""
    both = _directions(track, candidate)
    return 0.0 if both is None else 1.0 - min(float(np.sqrt(both[0] * both[1]).sum()), 1.0)  # Bhattacharyya


def _directions(track: _Track, candidate: Candidate) -> tuple[Array, Array] | None:
    """Those of the track and of the candidate, where both have some and of as many."""
    before, now = track.directions, candidate.directions
    return None if before is None or now is None or len(before) != len(now) else (before, now)


def _as_state(box: Array) -> Array:
    """Centre and log of the sizes of a box x1, y1, x2, y2."""
    size = np.maximum(box[2:] - box[:2], 1.0)
    return np.concatenate([(box[:2] + box[2:]) / 2, np.log(size)])


def _as_box(state: Array) -> Array:
    half = np.exp(state[2:]) / 2
    return np.concatenate([state[:2] - half, state[:2] + half])
