"""Data association of detected vehicles with those observed before: gates, and scipy's assignment.

    boxes of tracks, predicted ----+
                                   +---- gates, costs ---- assignment ---- ids; births; re-births; deaths
    boxes of detections -----------+

A track predicts its box by how the box has moved and grown, or by a given pose and velocity (`set_motion`), and where
it stands on the ground by how that has moved. A detection is a track's where the boxes overlap and the places agree;
the sum of 1 - overlap, of the places' deviation and of how little the directions that a network sees them from have in
common is least over all pairs. Sure detections choose first, then unsure
ones. A track that is not observed is sought for a while, and has its id back when it is observed again. A detection
that is no track's becomes one when it is observed again, unless it is certain or of the first frame: most of those
that are observed once are no vehicles.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import count
from typing import Protocol

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.compiled import assignment
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import box_around, box_overlaps, transform


@dataclass(frozen=True)
class AssociationSettings:
    """When a detection is a track's.

    Set by hand and seen to do on KITTI's labelled boxes; what births want was chosen on the shipped detector's boxes of
    90 frames each of KITTI's tracking drives 0000 and 0003.

    Attributes:
        min_overlap: Least intersection over union of the boxes.
        max_deviation_sigmas: Largest deviation of the places.
        min_birth_score: With which a track begins; weaker detections only continue one. Minus infinity where scores are
            of an unknown scale.
        birth_observations: Of so many frames, no two further apart than `alive_seconds`, is a track that begins.
        certain_birth_score: With which one is enough.
        alive_seconds: For which a track may be unobserved and still be first to choose.
        memory_seconds: After which it is given up.
        place_weight: Cost of a deviation of the places at its gate, relative to boxes that do not overlap.
        direction_weight: Cost of directions that have nothing in common, likewise.
        box_edge_sigma_px: Of a box's lower edge.
        pitch_sigma_rad: By which the camera pitches against the road from frame to frame.
        place_sigma_m: Of where a vehicle stands, beside what these two make of it.
        place_sigma_growth_m_per_s: Of where it should stand, for each second unobserved, beside a metre.
        border_px: From the image's lower border, where a box is cut off.
        box_gain: Share of a frame's rate in that of a box.
        place_gain: Share of a frame's deviation that is taken over into a place.
        place_rate_gain: The same into its velocity.
        direction_gain: Share of a frame's directions in those that are remembered.
        max_box_seconds: For which a box goes on at its rate, which soon says nothing more.
    """

    min_overlap: float = 0.25
    max_deviation_sigmas: float = 3.0
    min_birth_score: float = 0.5
    birth_observations: int = 2
    certain_birth_score: float = 0.95
    alive_seconds: float = 0.35
    memory_seconds: float = 2.0
    place_weight: float = 0.5
    direction_weight: float = 1.0
    box_edge_sigma_px: float = 3.0
    pitch_sigma_rad: float = 0.004
    place_sigma_m: float = 0.3
    place_sigma_growth_m_per_s: float = 4.0
    border_px: float = 2.0
    box_gain: float = 0.5
    place_gain: float = 0.5
    place_rate_gain: float = 0.15
    direction_gain: float = 0.3
    max_box_seconds: float = 0.5


SETTINGS = AssociationSettings()

_REFUSED = 1e6  # cost of what the gates refuse


@dataclass(frozen=True, eq=False)
class Candidate:
    """A detected vehicle.

    Attributes:
        box: (4,) x1, y1, x2, y2 in pixels.
        score: Of the detection, on the scale of `AssociationSettings.min_birth_score`.
        place: (3,) where it stands in the camera's frame, by its box (`ground_contact`), metres; or None.
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

    def set_motion(self, identity: int, points: Array, velocity: Array, camera: Camera, /) -> None:
        """Take the estimate of a vehicle in the frame that was given last.

        Args:
            identity: The vehicle.
            points: (M, 3) points of it in the camera's frame, metres.
            velocity: (3,) relative to the camera, in its frame, metres per second.
            camera: The camera.
        """


@dataclass(frozen=True, eq=False)
class _Track:
    """What is remembered of a vehicle, at the time it was observed last; rates are per second."""

    time: float
    box: Array  # centre, log of width and height
    box_rate: Array
    place: Array | None
    place_rate: Array
    spread: float
    given_rate: Array | None = None  # of the box, by a given motion in space
    directions: Array | None = None  # mean of the last ones, as in `Candidate`
    observations: int = 1


@dataclass
class GatedAssociation:
    """`Association` by gates and the assignment of least cost.

    Attributes:
        settings: When a detection is a track's.
        first: The first id.
        given_up: Called with each id that is given up and never comes back; or None.
    """

    settings: AssociationSettings = SETTINGS
    first: int = 0
    given_up: Callable[[int], None] | None = None
    _tracks: dict[int, _Track] = field(default_factory=dict, init=False)
    _ids: count[int] = field(init=False)
    _begun: list[_Track] = field(default_factory=list, init=False)
    _first_frame: bool = field(default=True, init=False)

    def __post_init__(self) -> None:
        """Begin to count."""
        self._ids = count(self.first)

    def __call__(
        self, time: float, candidates: Sequence[Candidate], previous_T_current: Array | None = None, /
    ) -> list[int | None]:
        """The id of each candidate; see `Association`."""
        how, first = self.settings, self._first_frame
        if previous_T_current is not None:
            moved: Array = np.linalg.inv(previous_T_current).astype(np.float64)
            self._tracks = {i: _in_frame(moved, track) for i, track in self._tracks.items()}
            self._begun = [_in_frame(moved, track) for track in self._begun]
        self._give_up(time)
        ids: list[int | None] = [None] * len(candidates)
        alive = [i for i, track in self._tracks.items() if time - track.time <= how.alive_seconds]
        lost = [i for i in self._tracks if i not in alive]
        sure = [place for place, candidate in enumerate(candidates) if candidate.score >= how.min_birth_score]
        for group, places in ((alive, sure), (alive, range(len(candidates))), (lost, sure)):
            left = [identity for identity in group if identity not in ids]
            free = [place for place in places if ids[place] is None]
            for row, place in self._assigned(time, [self._tracks[i] for i in left], candidates, free):
                ids[place] = left[row]
        for place, known in enumerate(ids):
            if known is not None:
                self._tracks[known] = self._updated(self._tracks[known], time, candidates[place])
        free = [place for place in sure if ids[place] is None]
        begun = {place: self._begun[row] for row, place in self._assigned(time, self._begun, candidates, free)}
        self._begun, self._first_frame = [], False
        for place in free:
            track = self._updated(begun.get(place), time, candidates[place])
            certain = first or candidates[place].score >= how.certain_birth_score
            if certain or track.observations >= how.birth_observations:
                self._tracks[known := next(self._ids)] = track
                ids[place] = known
            else:
                self._begun.append(track)
        return ids

    def _give_up(self, time: float) -> None:
        """Drop the tracks that were not observed for too long."""
        for identity in [i for i, track in self._tracks.items() if time - track.time > self.settings.memory_seconds]:
            del self._tracks[identity]
            if self.given_up is not None:
                self.given_up(identity)
        self._begun = [track for track in self._begun if time - track.time <= self.settings.alive_seconds]

    def set_motion(self, identity: int, points: Array, velocity: Array, camera: Camera, /) -> None:
        """Take the estimate of a vehicle: from now on its box is predicted by its motion in space."""
        track = self._tracks.get(identity)
        if track is None:
            raise InvalidInputError("identity", identity, "Give the id of a vehicle of the frame before.")
        ahead = 0.1  # seconds: near enough for a rate, far enough for rounding
        later = points + ahead * velocity
        if not (points[:, 2].min() > 1.0 and later[:, 2].min() > 1.0):  # too near for a box of projections
            return
        now, then = (_as_state(box_around(camera.project(p))) for p in (points, later))
        self._tracks[identity] = replace(track, given_rate=(then - now) / ahead)

    def _assigned(
        self, time: float, tracks: Sequence[_Track], candidates: Sequence[Candidate], places: Sequence[int]
    ) -> list[tuple[int, int]]:
        """Pairs of a track and one of these places of candidates, of least cost in all that the gates let pass."""
        if not (tracks and places):
            return []
        costs = self._costs(time, tracks, [candidates[place] for place in places])
        rows, columns = assignment().linear_sum_assignment(costs)
        return [(int(r), places[c]) for r, c in zip(rows, columns, strict=True) if costs[r, c] < _REFUSED]

    def _costs(self, time: float, tracks: Sequence[_Track], candidates: Sequence[Candidate]) -> Array:
        """(tracks, candidates) cost of every pair; `_REFUSED` where a gate refuses it."""
        costs = np.full((len(tracks), len(candidates)), _REFUSED)
        how = self.settings
        predicted = np.array([_as_box(self._box_at(track, time)) for track in tracks])
        overlap = box_overlaps(predicted, np.array([c.box for c in candidates]))
        for row, track in enumerate(tracks):
            for column, candidate in enumerate(candidates):
                off = self._deviation(track, candidate, time)
                if overlap[row, column] >= how.min_overlap and off <= how.max_deviation_sigmas:
                    share = (off / how.max_deviation_sigmas) ** 2
                    mismatch = how.direction_weight * _direction_mismatch(track, candidate)
                    costs[row, column] = 1.0 - overlap[row, column] + how.place_weight * share + mismatch
        return costs

    def _box_at(self, track: _Track, time: float) -> Array:
        """The box's state, predicted: by its own rate, or by the given motion as well."""
        rate = track.box_rate if track.given_rate is None else 0.5 * (track.given_rate + track.box_rate)
        return track.box + rate * min(time - track.time, self.settings.max_box_seconds)

    def _deviation(self, track: _Track, candidate: Candidate, time: float) -> float:
        """How far a candidate stands from where the track should, standard deviations; 0 where one does not know."""
        if track.place is None or candidate.place is None:
            return 0.0
        passed = time - track.time
        off = float(np.linalg.norm(candidate.place - track.place - passed * track.place_rate))
        grown = 1.0 + self.settings.place_sigma_growth_m_per_s * passed
        return off / float(np.hypot(np.hypot(track.spread, candidate.spread), grown))

    def _updated(self, track: _Track | None, time: float, candidate: Candidate) -> _Track:
        """The track with what is observed of it now."""
        box, how = _as_state(candidate.box), self.settings
        if track is None:
            still = np.zeros(4), candidate.place, np.zeros(3)
            return _Track(time, box, *still, candidate.spread, directions=candidate.directions)
        observations = track.observations + 1
        passed = max(time - track.time, 1e-3)
        rate = (box - track.box) / passed
        box_rate = (1.0 - how.box_gain) * track.box_rate + how.box_gain * rate if track.box_rate.any() else rate
        place, place_rate = candidate.place, track.place_rate
        if track.place is not None:
            guess = track.place + passed * place_rate
            off = np.zeros(3) if place is None else place - guess
            place, place_rate = guess + how.place_gain * off, place_rate + how.place_rate_gain * off / passed
        directions = track.directions if candidate.directions is None else candidate.directions
        if (both := _directions(track, candidate)) is not None:
            before, now = both
            directions = before + how.direction_gain * (now - before)
        return _Track(time, box, box_rate, place, place_rate, candidate.spread, None, directions, observations)


def ground_contact(box: Array, camera: Camera, ground: Ground) -> tuple[Array, float] | None:
    """Where the line of sight through the middle of a box's lower edge meets the ground, and how sure that is.

    Args:
        box: (4,) x1, y1, x2, y2 in pixels.
        ground: The ground in its frame.

    Returns:
        (3,) the place in the camera's frame and its standard deviation along the line of sight from frame to frame,
        metres; None where the box is cut off by the image's lower border, or the line meets no ground.
    """
    if camera.image_size is not None and box[3] > camera.image_size[1] - 1 - SETTINGS.border_px:
        return None
    foot = np.array([[(box[0] + box[2]) / 2, box[3]], [(box[0] + box[2]) / 2, box[3] + SETTINGS.box_edge_sigma_px]])
    rays = camera.rays(camera.undistort(foot))
    falls = rays @ ground.normal
    if falls[0] <= 1e-3:
        return None
    place, nearer = (ground.distance / fall * ray for ray, fall in zip(rays, falls, strict=True))
    pitched = float(SETTINGS.pitch_sigma_rad * place[2] / falls[0])
    return place, float(np.hypot(np.linalg.norm(place - nearer), pitched)) + SETTINGS.place_sigma_m


def _in_frame(current_T_previous: Array, track: _Track) -> _Track:
    """The track's place after the camera has moved."""
    if track.place is None:
        return track
    turn = current_T_previous[:3, :3]
    place = transform(current_T_previous, track.place[None])[0]
    return replace(track, place=place, place_rate=turn @ track.place_rate)


def _direction_mismatch(track: _Track, candidate: Candidate) -> float:
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
