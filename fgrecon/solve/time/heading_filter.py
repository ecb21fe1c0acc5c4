"""Heading of a vehicle over time: a Bayes filter over a grid of headings.

    heading(0) ---- turn ---- heading(1) ---- turn ---- heading(2) ...
        |                         |                         |
      frame                     frame                     frame
      +------- one view --------+                      another view

What a frame says is a density over headings (`rotation_y` in its camera): a bump at each pose that its keypoints allow,
by its energy; smaller bumps half a turn away, since a network that takes a front for a rear does so with all keypoints;
the network's directions, which know of the other vehicles (`image_facing`); and where the vehicle has gone, if the
world is known. Neither is ever certain. From frame to frame a vehicle turns little, and next to never faces elsewhere
altogether: frames of another vehicle begin anew (`vehicle_filter`).

A network is wrong about a vehicle for as long as it sees it alike. So all frames of one view, of about one direction
and one size in the image, say together little more than one of them: their mean, which counts the more the more they
are, but never as more than two images. Another view counts anew. Whatever was believed before, the vehicle faces as its
last images alone say where these are surer: of what errs alike to an unknown degree the surer counts, and no belief is
locked.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.detection import at_direction, facing_probability, half_around
from fgrecon.core.geometry import view_azimuth, yaw_rotation
from fgrecon.core.metrics import wrap_angle
from fgrecon.solve.time.time_settings import SETTINGS

_BINS = 72
HEADINGS = 2.0 * np.pi * np.arange(_BINS) / _BINS
"""(B,) headings of the grid, `rotation_y` in radians."""

_HALVES = np.array([half_around(heading, _BINS) for heading in HEADINGS])
_WITHIN = np.abs(wrap_angle(HEADINGS - HEADINGS[:, None])) <= np.pi / 2.0  # (B, B) of each the half around it


@dataclass(frozen=True)
class Belief:
    """Probability (B,) of each heading."""

    probability: Array

    @classmethod
    def none(cls) -> Belief:
        """Every heading alike."""
        return cls(np.full(_BINS, 1.0 / _BINS))

    def updated(self, evidence: Array) -> Belief:
        """With a frame's evidence (B,), logarithms."""
        posterior = self.probability * np.exp(evidence - evidence.max())
        return Belief(posterior / posterior.sum())

    def predicted(self, seconds: float, camera_turn: float) -> Belief:
        """After some time; by `camera_turn` the `rotation_y` of a thing at rest changes meanwhile."""
        return Belief(_kernel_product(self.probability, seconds, camera_turn))

    @property
    def heading(self) -> float:
        """The most probable heading of the more probable half of all, radians."""
        return float(HEADINGS[self._bin])

    @property
    def _bin(self) -> int:
        """Place of the heading in the grid."""
        half = _WITHIN[(_HALVES @ self.probability).argmax()]
        return int(np.where(half, self.probability, -1.0).argmax())

    @property
    def sureness(self) -> float:
        """Probability of the headings within a quarter turn of the heading."""
        return min(float(_HALVES[self._bin] @ self.probability), 1.0)

    def facing(self, heading: float) -> float:
        """Probability of the headings within a quarter turn of one."""
        return float(np.clip(facing_probability(self.probability, heading), 0.0, 1.0))


def another_side(first: float, second: float) -> bool:
    """Whether two headings are so far apart that they are of different poses."""
    return abs((first - second + math.pi) % (2.0 * math.pi) - math.pi) > SETTINGS.same_side_rad


def pose_evidence(headings: Sequence[float], energies: Sequence[float], *, alone: bool) -> Array:
    """(B,) logarithms of what poses say, of which one is right or none.

    Args:
        headings: Of the poses.
        energies: Of them, nats.
        alone: Whether no directions are given beside them.
    """
    flipped = SETTINGS.flip_probability if alone else SETTINGS.flip_probability_beside_directions
    energy = np.asarray(energies, dtype=np.float64)
    share = np.exp(SETTINGS.energy_temper * (energy.min() - energy))
    share /= share.sum()
    off = wrap_angle(HEADINGS[:, None] - np.asarray(headings, dtype=np.float64))
    here, there = _bump(off) @ share, _bump(wrap_angle(off + np.pi)) @ share
    nothing = SETTINGS.uninformative_probability
    density = (1.0 - flipped - nothing) * here + flipped * there + nothing * (1.0 / (2.0 * np.pi))
    return np.asarray(np.log(density))


def direction_evidence(azimuth: Array | None, location: Array) -> Array:
    """(B,) logarithms of what the network's directions (A,) say of a vehicle at a place (3,) in the camera's frame."""
    if azimuth is None:
        return np.zeros(_BINS)
    directions = view_azimuth(yaw_rotation(HEADINGS), np.broadcast_to(location, (_BINS, 3)))
    density, nothing = at_direction(azimuth, directions) * len(azimuth), SETTINGS.uninformative_directions_probability
    return np.asarray(np.log((1.0 - nothing) * density + nothing))


def path_evidence(moved: Array, sigma: float) -> Array:
    """(B,) logarithms of what a path (3,) over the world says, known to `sigma` metres: vehicles seldom reverse."""
    distance = float(np.hypot(moved[0], moved[2]))
    heading = float(np.arctan2(-moved[2], moved[0]))
    spread = float(np.hypot(SETTINGS.pose_heading_sigma_rad, np.arctan2(sigma, distance)))
    sure = float(np.clip(distance / (3.0 * sigma) - 1.0, 0.0, 1.0))
    return np.asarray(sure * _either_way(heading, spread, SETTINGS.reverse_probability))


def box_evidence(heading: float, sigma: float, flipped: float) -> Array:
    """(B,) logarithms of what another detector's box of a heading says, 1 sigma; so many boxes are flipped."""
    return _either_way(heading, float(np.hypot(SETTINGS.pose_heading_sigma_rad, sigma)), flipped)


def _either_way(heading: float, spread: float, flipped: float) -> Array:
    """(B,) logarithms of a heading that is right, opposite with a probability, or says nothing."""
    off = np.abs(wrap_angle(HEADINGS - heading))
    here, there = (np.exp(-0.5 * np.square(one / spread)) for one in (off, np.pi - off))
    bump = ((1.0 - flipped) * here + flipped * there) / (np.sqrt(2.0 * np.pi) * spread)
    nothing = SETTINGS.uninformative_probability
    return np.asarray(np.log((1.0 - nothing) * bump + nothing / (2.0 * np.pi)))


def _carried(evidence: Array, seconds: float, camera_turn: float) -> Array:
    """(B,) logarithms of what evidence (B,) says some time later."""
    likelihood = np.exp(evidence - evidence.max())
    return np.log(_kernel_product(likelihood / likelihood.sum(), seconds, camera_turn))


@dataclass(frozen=True)
class Aspect:
    """How a vehicle is seen."""

    azimuth: float  # from where, radians; front and rear are alike
    log_height: float  # logarithm of its height in the image

    @classmethod
    def of(cls, heading: float, place: Array, height: float) -> Aspect:
        """Of a vehicle of a heading at a place (3,), metres, and its height in the image, pixels."""
        return cls(float(view_azimuth(yaw_rotation(heading), place)), float(np.log(max(height, 1.0))))

    def differs(self, other: Aspect) -> bool:
        """Whether what a network says of one is not what it says of the other for that alone."""
        off = float(wrap_angle(2.0 * (self.azimuth - other.azimuth))) / 2.0
        closer = self.log_height - other.log_height
        return bool(np.hypot(off / SETTINGS.view_azimuth_rad, closer / SETTINGS.view_log_height) > 1.0)


@dataclass(frozen=True)
class TrackHeading:
    """What the frames of a vehicle say of its heading in the last one."""

    earlier: Belief  # by the views before the last
    way: Belief  # by where it has gone
    view: Aspect  # the last view, as it began
    mean: Array  # (B,) logarithms of what a frame of that says, on average
    frames: int  # how many it has
    first: bool  # whether there was none before it in time; it counts as one image at least
    recent: Array  # (B,) logarithms of what the last images say on average, each counting less than the one after it

    @classmethod
    def begun(cls, image: Array, place: Array, height: float) -> TrackHeading:
        """By a first frame: its image (B,), logarithms, of a vehicle at a place (3,), so many pixels high."""
        view = Aspect.of(Belief.none().updated(image).heading, place, height)
        return cls(Belief.none(), Belief.none(), view, image, frames=1, first=True, recent=image)

    def following(
        self, seconds: float, turn: float, image: Array, place: Array, height: float, way: Array | None
    ) -> TrackHeading:
        """With the next frame.

        Args:
            seconds: To that frame.
            turn: By how much `rotation_y` of a thing at rest has changed, radians.
            image: (B,) logarithms of what its image says.
            place: (3,) about where the vehicle is, metres.
            height: Of it in the image, pixels.
            way: (B,) logarithms of what its way up to there says; None for nothing new.
        """
        mean, recent = (_carried(one, seconds, turn) for one in (self.mean, self.recent))
        moved = replace(
            self,
            earlier=self.earlier.predicted(seconds, turn),
            way=self.way.predicted(seconds, turn).updated(np.zeros(_BINS) if way is None else way),
            mean=mean + (image - mean) / (self.frames + 1),
            frames=self.frames + 1,
            recent=recent + SETTINGS.recent_share * (image - recent),
        )
        view = Aspect.of(moved.whole.heading, place, height)
        if not view.differs(self.view):
            return moved
        before = replace(moved, mean=mean, frames=self.frames)
        first = self.first and seconds < SETTINGS.simultaneous_s
        return replace(moved, earlier=before.by_views, view=view, mean=image, frames=1, first=first)

    @property
    def by_views(self) -> Belief:
        """By what a network says in all views."""
        counts = SETTINGS.view_images * self.frames / (self.frames + SETTINGS.view_half_frames)
        if self.first:
            counts = max(counts, 1.0)
        return self.earlier.updated(counts * self.mean)

    @property
    def whole(self) -> Belief:
        """By all of them."""
        return self.by_views.updated(np.log(self.way.probability))

    @property
    def belief(self) -> Belief:
        """By all of them, or by the last images alone where these are surer, and by the way."""
        surer = max(self.by_views, Belief.none().updated(self.recent), key=lambda one: one.sureness)
        return surer.updated(np.log(self.way.probability))


def earlier_beliefs(last: Belief, images: Sequence[Array], steps: Sequence[tuple[float, float]]) -> list[Belief]:
    """Of frames by what the last one knows: that tells the facing, and each image but which axis the vehicle is along.

    Args:
        last: Of the last frame.
        images: (B,) logarithms of what the image of each says.
        steps: Seconds, and the camera's turn, from each frame to the next.

    Returns:
        The belief of each frame, the last one's included.
    """
    found = [last]
    for image, (seconds, turn) in zip(images[-2::-1], steps[::-1], strict=True):
        axis = np.logaddexp(image, np.concatenate([image[_BINS // 2 :], image[: _BINS // 2]]))
        found.append(found[-1].predicted(seconds, -turn).updated(axis))
    return found[::-1]


def _bump(off: Array) -> Array:
    spread = SETTINGS.pose_heading_sigma_rad
    return np.asarray(np.exp(-0.5 * np.square(off / spread)) / (np.sqrt(2.0 * np.pi) * spread))


def _kernel_product(probability: Array, seconds: float, turn: float) -> Array:
    """Turned, blurred, and with a little of everything."""
    smooth = np.maximum(_turned(seconds, turn) @ probability, 0.0)
    elsewhere = min(SETTINGS.jump_probability_per_s * seconds, 0.5)
    return (1.0 - elsewhere) * smooth / smooth.sum() + elsewhere / _BINS


@lru_cache(maxsize=64)  # the steps of a window come again with the next frame, for each vehicle
def _turned(seconds: float, turn: float) -> Array:
    """(B, B) what turns and blurs: a Fourier series, exact on the circle."""
    order = np.arange(_BINS // 2 + 1)
    spread = SETTINGS.turn_rate_sigma_rad * np.sqrt(seconds)
    kernel = np.fft.irfft(np.exp(-1j * order * turn - 0.5 * np.square(order * spread)), _BINS)
    return np.asarray(kernel[np.arange(_BINS)[:, None] - np.arange(_BINS)])
