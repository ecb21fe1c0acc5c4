"""The focal length of a video that nobody knows."""

import numpy as np
import pytest

from fgrecon.core.camera import Camera
from fgrecon.core.options import Options
from fgrecon.io.catalogue import load_prior
from fgrecon.io.source_frames import SourceFrame
from fgrecon.video.focal import estimate_camera
from fgrecon.video.records import FrameRecord, Sighting
from tests.cars import CAMERA, observe, yaw_pose
from tests.video.streets import SIZE

UNKNOWN = Camera.of_unknown(*SIZE)
ARGUMENTS = {"prior": "car14", "ground": 1.65, "options": Options(keep_history=False)}


class Frames:
    """As many frames as there are looks, so many seconds apart."""

    def __init__(self, count, apart):
        self.frames = [SourceFrame(n, n * apart, str(n), np.zeros((*SIZE[::-1], 3), np.uint8)) for n in range(count)]

    def read(self, after=None):
        yield from self.frames


def passing(count, cars=3):
    """For each car its observations, one a frame; another one comes with every frame, 8 to 20 m away."""
    prior, rng = load_prior("car14"), np.random.default_rng(0)

    def one(frame, car):
        pose = yaw_pose(rng.uniform(-np.pi, np.pi))
        pose[:3, 3] = [rng.uniform(-3.0, 3.0), 1.65, rng.uniform(8.0, 20.0)]
        return observe(prior, pose, rng.normal(size=5), noise=1.0, seed=10 * frame + car)

    return [[one(frame, car) for frame in range(count)] for car in range(cars)]


def looking(cars, seen):
    def look(frame):
        seen.append(frame.number)
        sightings = [Sighting(car[frame.number].box, 1.0, None, car[frame.number]) for car in cars]
        return FrameRecord(frame.number, frame.time, frame.name, None, tuple(sightings))

    return look


def test_the_cars_of_frames_a_second_apart_tell_it():
    cars, seen = passing(12), []
    found = estimate_camera(Frames(12, 0.5), looking(cars, seen), UNKNOWN, **ARGUMENTS)
    assert seen == [0, 2, 4, 6, 8, 10]
    assert (found.vehicles, found.images) == (18, 6)
    off = np.log(found.camera.matrix[0, 0] / CAMERA.matrix[0, 0])
    assert abs(off) < 0.2 < np.log(UNKNOWN.matrix[0, 0] / CAMERA.matrix[0, 0])
    assert abs(off) < 3.0 * found.camera.focal_sigma < 0.9


def test_it_ends_with_what_is_enough():
    cars, seen = passing(12, 1), []
    estimate_camera(Frames(12, 1.0), looking(cars, seen), UNKNOWN, **ARGUMENTS)
    assert seen == list(range(8))


@pytest.mark.parametrize("count", [0, 3])
def test_without_a_car_nobody_tells(count):
    assert estimate_camera(Frames(count, 1.0), looking([], []), UNKNOWN, **ARGUMENTS) is None
