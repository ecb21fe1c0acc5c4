"""Vehicles of a video from other programs: boxes or keypoints by frame, with ids or without.

| file | what is in it |
|---|---|
| `.txt` | KITTI's tracking labels or results: boxes of cars and vans; the track -1 is none |
| `.txt` | MOT's lines `frame,id,x,y,w,h,score,...`: boxes; the id -1 is none. With a class (nine columns), cars alone |
| `.json` | a keypoint file whose instances name their `frame`, or an `image`; and a `track` |
| `.json` | a track file: one vehicle |
| folder | a file of boxes for each image, of its name (YOLO's `class x y w h [score] id`, KITTI's, CSV); of a video |
| | `NAME_1.txt` for its first frame, as ultralytics writes them, else the number of the frame |
| `.csv` | boxes that name their images |

An `image` is that of the frames whose name it has, where these are images whose names tell no numbers; else the last
number of its name is its frame's. Where there are no frames but the file's, they are found by the names of the images
as those of a folder are (`fgrecon.io.source_frames`).
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from operator import and_
from pathlib import Path

import numpy as np

from fgrecon.core.camera import Camera
from fgrecon.core.category import Category
from fgrecon.core.choices import BoxModel
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import box_around
from fgrecon.io.boxes import ENDINGS, boxes_in
from fgrecon.io.catalogue import class_of_kind
from fgrecon.io.files import filled_lines
from fgrecon.io.frames import FrameSource, ImageFrames
from fgrecon.io.json_fields import read_json
from fgrecon.io.keypoint_file import Instance, parse_keypoints
from fgrecon.io.kitti_files import read_tracking
from fgrecon.io.lens_fields import scale_between
from fgrecon.io.source_frames import frames_by_name, number_of
from fgrecon.io.track_file import parse_track
from fgrecon.video.association import AssociationSettings
from fgrecon.video.records import Sighting

KINDS = ("Car", "Van")
"""Types of KITTI's objects that are taken, in capitals or not."""

_ANY = ("vehicles of a known class",)

_REGION = "dontcare"  # KITTI's areas without labels

_LARGEST_ID = 2**62  # ids that are given anew go on from the largest, and tables have 64 bits for them

_MOT_COLUMNS, _MOT_LABEL_COLUMNS, _MOT_CAR = 6, 9, 3
_FORMATS = "KITTI's tracking lines, MOT's (class 3 where they tell classes), a file for each image or a keypoint file"
_MOT_FIX = (
    "Give MOT's lines: frame,id,x,y,w,h with a score or more behind it, x and y of the upper left corner in pixels."
)

_Rows = list[tuple[int, Sighting]]
_Times = Mapping[int, float]


@dataclass(frozen=True, eq=False)
class Given:
    """What others have found.

    Attributes:
        vehicles: By the number of their frame.
        camera: The camera that the file names first, or None.
        cuboids: Whether the boxes enclose projected 3D boxes, as KITTI's do; else outlines.
        times: Seconds of the frames, by number; None where the file tells none.
        left_out: How many boxes of other types the file has, by type.
        kinds: The types that are taken.
    """

    vehicles: Mapping[int, tuple[Sighting, ...]]
    camera: Camera | None
    cuboids: bool
    times: _Times | None = None
    left_out: Mapping[str, int] = field(default_factory=dict)
    kinds: tuple[str, ...] = KINDS

    @property
    def largest_id(self) -> int:
        """The largest id; -1 where there is none."""
        ids = (s.identity for sightings in self.vehicles.values() for s in sightings)
        return max((identity for identity in ids if identity is not None), default=-1)

    @property
    def ends(self) -> dict[int, int]:
        """Number of the last frame of each id, the earliest first."""
        last = {s.identity: number for number in sorted(self.vehicles) for s in self.vehicles[number]}
        known = ((identity, number) for identity, number in last.items() if identity is not None)
        return dict(sorted(known, key=lambda end: end[1]))

    @property
    def association(self) -> AssociationSettings:
        """How those without an id are followed: each begins a track, since scores of boxes are of any scale."""
        return AssociationSettings(min_birth_score=-np.inf, birth_observations=1)

    def fitted(self, size: tuple[int, int] | None, *, scale: bool = False) -> Given:
        """The same in pixels of images of a size; None where it is not known.

        Args:
            size: Width and height in pixels.
            scale: Whether points may be scaled, where the file states another size of the same shape.

        Raises:
            InvalidInputError: The file states another size, and scaling is not requested or the shapes differ.
        """
        every = {number: tuple(_fitted(s, size, scale=scale) for s in some) for number, some in self.vehicles.items()}
        return replace(self, vehicles=every)

    @property
    def complete(self) -> bool:
        """Whether every vehicle has its keypoints, so that no network need look."""
        return all(s.observation is not None for sightings in self.vehicles.values() for s in sightings)


def read_given(
    path: Path,
    category: Category,
    *,
    forget_ids: bool = False,
    source: FrameSource | None = None,
    all_classes: bool = False,
) -> Given:
    """The vehicles of a file.

    Args:
        path: The file.
        category: Category of its keypoints.
        forget_ids: Whether ids are left out, so that vehicles are associated anew.
        source: The frames that they are of; None where the file alone tells them.
        all_classes: Whether lorries, buses and trams are taken as well.

    Raises:
        InvalidInputError: The file has another format, an instance names no frame, or an id is too large or twice in
            one; names it.
    """
    left_out: Counter[str] = Counter()
    kinds: tuple[str, ...] = KINDS
    cuboids, camera, times = False, None, None
    if path.is_dir() or path.suffix.lower() == ".csv":
        rows, cuboids = _of_images(path, source, left_out, all_classes=all_classes)
        kinds = KINDS[:1]
    elif path.suffix.lower() == ".json":
        rows, camera, times = _keypoints(path, category, source)
    elif _is_mot(path):
        rows = _mot(path, source, left_out)
    else:
        rows, cuboids = _boxes(path, left_out, all_classes=all_classes), True
    by_frame: dict[int, list[Sighting]] = defaultdict(list)
    for number, sighting in rows:
        by_frame[number].append(replace(sighting, identity=None) if forget_ids else sighting)
    for number, sightings in by_frame.items():
        _check_ids([s.identity for s in sightings if s.identity is not None], f"{path}: frame {number}")
    if not by_frame:
        value = f"{path} with {in_words(left_out)}" if left_out else str(path)
        raise InvalidInputError("tracks", value, f"Give a file with a vehicle: {' or '.join(kinds)}; {_FORMATS}.")
    vehicles = {number: tuple(sightings) for number, sightings in by_frame.items()}
    return Given(vehicles, camera, cuboids, times, left_out, _ANY if all_classes else kinds)


def _of_images(
    path: Path, source: FrameSource | None, left_out: Counter[str], *, all_classes: bool
) -> tuple[_Rows, bool]:
    """The boxes of a folder with a file for each image, or of a CSV that names them; and whether of cuboids."""
    first = None if source is None else next((f.image for f in source.read() if f.image is not None), None)
    if source is None or first is None:
        raise InvalidInputError("tracks", str(path), "Give images or a video whose frames these boxes are of.")
    rows, cuboids, others = [], False, []
    names = _images_of_frames(path, source)
    for number, image in names.items():
        size = first.shape[1], first.shape[0]
        found = boxes_in(path, image, size, least_score=0.0, all_classes=all_classes)
        left_out.update({kind: count for kind, count in found.classes.items() if kind.lower() != _REGION})
        others.append(found.images)
        cuboids |= any(one.model is BoxModel.CUBOID for one in found.cars)
        for one in found.cars:
            score, kind = 1.0 if one.score is None else one.score, None if one.kind is None else one.kind.capitalize()
            rows.append((number, Sighting(one.corners, score, one.track, None, kind, one.vehicle_class)))
    if elsewhere := sum(reduce(and_, others, others[0]).values() if others else ()):  # of no image among the frames
        left_out["of images that are no frames"] += elsewhere
    return rows, cuboids


def _images_of_frames(path: Path, source: FrameSource) -> dict[int, str]:
    """What boxes call the image of each frame, without ending."""
    if isinstance(source, ImageFrames) and not (source.numbered and path.is_dir()):
        named = zip(source.numbers, source.paths, strict=True)
        return {number: str(file.absolute().parent / file.stem) for number, file in named}
    if not path.is_dir():
        raise InvalidInputError("tracks", str(path), f"Give images that it names; of a video {_FORMATS}.")
    video = "" if isinstance(source, ImageFrames) else f"{source.first_file.stem}_"
    found = {}
    for stem in sorted(file.stem for file in path.iterdir() if file.suffix.lower() in ENDINGS):
        of_video = bool(video) and stem.startswith(video)  # ultralytics counts a video's frames from 1
        number = number_of(stem.removeprefix(video) if of_video else stem)
        if number is not None:
            found[number - of_video] = stem
    return found


def in_words(counts: Mapping[str, int]) -> str:
    """How many of each type: `3 Truck, 1 Tram`."""
    return ", ".join(f"{count} {kind}" for kind, count in sorted(counts.items()))


def _check_ids(ids: Sequence[int], place: str) -> None:
    twice = next((i for i in ids if ids.count(i) > 1), None)
    if twice is not None:
        raise InvalidInputError(place, f"track {twice}, twice", "Give each vehicle its own id.")
    if (largest := max(ids, default=0)) > _LARGEST_ID:
        raise InvalidInputError(place, f"track {largest}", f"Give ids up to {_LARGEST_ID}.")


def _boxes(path: Path, left_out: Counter[str], *, all_classes: bool) -> _Rows:
    """KITTI's boxes; those of other types are counted."""
    rows = []
    for number, labels in read_tracking(path).items():
        for i, written in enumerate(labels.objects.kind):
            kind = written.capitalize()
            known = class_of_kind(kind)
            if kind in KINDS or (all_classes and known is not None):
                score, track = float(labels.objects.score[i]), int(labels.tracks[i])
                identity = None if track < 0 else track
                sure = 1.0 if np.isnan(score) else score
                rows.append((number, Sighting(labels.objects.box[i], sure, identity, None, kind, known)))
            elif kind.lower() != _REGION:
                left_out[written] += 1
    return rows


def _is_mot(path: Path) -> bool:
    """Whether the first line has MOT's commas; a file that cannot be read is refused by whoever reads it."""
    try:
        return "," in next((line for line in path.read_text(encoding="utf-8-sig").splitlines() if line.strip()), "")
    except (OSError, UnicodeDecodeError):
        return False


def _mot(path: Path, source: FrameSource | None, left_out: Counter[str]) -> _Rows:
    """MOT's boxes. Its frames count from 1, as its images do, those of a video from 0; other classes are counted."""
    first = 0 if source is None or (isinstance(source, ImageFrames) and source.numbered) else 1
    rows = []
    for place, line in filled_lines(path, "tracks"):
        try:
            values = np.array(line.split(","), dtype=np.float64)
            (frame, identity), size = values[:2].astype(np.int64).tolist(), values[4:6]
            whole = np.isfinite(values).all() and (values[:2] == (frame, identity)).all()
            if not (whole and frame >= first and (size > 0).all() and _MOT_COLUMNS <= len(values) <= _MOT_COLUMNS + 4):
                raise ValueError(line)
        except ValueError as error:
            raise InvalidInputError(place, line[:80], _MOT_FIX) from error
        if len(values) == _MOT_LABEL_COLUMNS and (values[7] != _MOT_CAR or values[6] == 0):
            left_out["not to be considered" if values[6] == 0 else f"of class {values[7]:g}"] += 1
            continue
        score = 1.0 if len(values) == _MOT_COLUMNS or values[6] == -1 else float(values[6])
        box = np.concatenate([values[2:4], values[2:4] + size])
        rows.append((frame - first, Sighting(box, score, identity if identity >= 0 else None, None)))
    return rows


def _keypoints(
    path: Path, category: Category, source: FrameSource | None
) -> tuple[_Rows, Camera | None, _Times | None]:
    data = read_json(path)
    if isinstance(data, Mapping) and "frames" in data and "keypoints" not in data:
        track = parse_track(data, path.stem, category, where=f"{path}: ")
        observations = [(int(frame.name.rpartition(":")[2]), frame.observation) for frame in track.frames]
        rows = [(n, Sighting(o.box, 1.0, 0, o)) for n, o in observations if o is not None and o.box is not None]
        return rows, track.camera, None
    instances = parse_keypoints(data, category, where=f"{path}: ").instances
    camera = next((instance.camera for instance in instances if instance.camera is not None), None)
    numbers, times = _numbers(instances, path, source)
    rows = [(n, _sighting(one, path)) for n, one in zip(numbers, instances, strict=True) if n is not None]
    return rows, camera, times


def _numbers(
    instances: Sequence[Instance], path: Path, source: FrameSource | None
) -> tuple[list[int | None], _Times | None]:
    """The number of each instance's frame, None where it is none of the source's; and times where names tell them."""
    images = {one.image for one in instances if one.frame is None and one.image is not None}
    numbers: Mapping[str, int | None] = {image: number_of(Path(image).stem) for image in images}
    times: _Times | None = None
    by_place = isinstance(source, ImageFrames) and not source.numbered
    if isinstance(source, ImageFrames) and by_place:
        numbers = _of_frames(images, source)
    elif source is None and None in numbers.values() and all(re.search(r"\d", Path(image).stem) for image in images):
        if any(one.frame is not None for one in instances):
            fix = "Give the number of its frame, as others do: the names of the images tell none."
            raise InvalidInputError(f"{path}: frame", "nothing", fix)
        numbers, times = _in_order(images)
    of_instances = []
    for one in instances:
        number = numbers.get(one.image or "") if one.frame is None else one.frame
        if number is None and (one.image is None or not by_place):
            fix = "Give the number of its frame, or an image that ends in it."
            raise InvalidInputError(f"{path}: instance {one.name}: frame", one.image, fix)
        of_instances.append(number)
    if isinstance(source, ImageFrames) and all(number is None for number in of_instances):
        fix = f"Give images as the frames are named, such as {source.names[0]}, or numbers of frames."
        raise InvalidInputError(f"{path}: image", instances[0].image, fix)
    return of_instances, times


def _of_frames(images: Iterable[str], source: ImageFrames) -> dict[str, int | None]:
    """The numbers of images among a source's frames, by their names without endings, and folders as far as given."""
    known = dict(zip(map(_parts, source.names), source.numbers, strict=True))
    return {
        image: next((known[parts[i:]] for i in range(len(parts)) if parts[i:] in known), None)
        for image, parts in ((image, _parts(image)) for image in images)
    }


def _parts(name: str) -> tuple[str, ...]:
    path = Path(name)
    return (*path.parts[:-1], path.stem)


def _in_order(images: Iterable[str]) -> tuple[dict[str, int | None], _Times | None]:
    """The numbers of images that are all there is of the frames, and the times that their names tell."""
    frames = frames_by_name({Path(image).stem: Path(image) for image in images}.values())
    numbers = {path.stem: number for path, number in zip(frames.paths, frames.numbers, strict=True)}
    times = None if frames.times is None else dict(zip(frames.numbers, frames.times, strict=True))
    return {image: numbers[Path(image).stem] for image in images}, times


def _fitted(sighting: Sighting, size: tuple[int, int] | None, *, scale: bool) -> Sighting:
    observation = sighting.observation
    if observation is None or size is None:
        return sighting
    ratio = np.array(scale_between(observation.image_size, size, "tracks: image_size", scale=scale))
    if (ratio == 1.0).all():
        return sighting
    return replace(sighting, box=sighting.box * np.tile(ratio, 2), observation=observation.scaled(ratio, size))


def _sighting(instance: Instance, path: Path) -> Sighting:
    place = f"{path}: instance {instance.name}"
    try:
        observation = instance.observation
    except InvalidInputError as error:
        raise InvalidInputError(f"{place}: {error.field}", error.value, error.fix) from error
    points = observation.keypoints[observation.measured]
    if not len(points):
        raise InvalidInputError(f"{place}: keypoints", "none", "Give at least one, or leave the instance out.")
    around = box_around(points)
    box = around if observation.box is None else observation.box
    score = 1.0 if instance.score is None else instance.score
    return Sighting(box, score, instance.track, observation, instance.kind, instance.classed.vehicle_class)
