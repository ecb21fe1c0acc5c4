"""Made-up photographs: a known shape, seen from known poses."""

from functools import partial

import numpy as np

from fgrecon.io.catalogue import load_prior
from fgrecon_research.training.keypoints.posed_cars import PosedCar


def unit_car_prior():
    """The shipped prior in the unit of posed photographs: centred, its mean box's diagonal is one."""
    prior = load_prior("car14")
    vertices = prior.surface.mean
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    scale = 1.0 / np.linalg.norm(high - low)
    small = prior.scaled(scale)
    centre = (low + high) / 2 * [1, 1, 0] * scale
    from dataclasses import replace

    surface = replace(small.surface, mean=small.surface.mean - centre)
    return replace(small, mean=small.mean - centre, surface=surface)


def made_up_cars(prior, coefficients, count, rng, folder="nowhere"):
    """Photographs of one shape, each cropped to the projected surface exactly."""
    from pathlib import Path

    vertices = prior.surface.vertices(coefficients)
    cars = []
    for number in range(count):
        angle, tilt = rng.uniform(-np.pi, np.pi), rng.uniform(0.0, 0.2)
        turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
        down = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
        rotation, translation = down @ turn, np.array([0.0, 0.0, rng.uniform(1.1, 1.8)])
        camera = vertices @ rotation.T + translation
        pixels = camera[:, :2] / camera[:, 2:]
        low, high = pixels.min(axis=0), pixels.max(axis=0)
        focal = 250.0 / (high - low).max()
        size = np.maximum(np.rint((high - low) * focal), 1).astype(int)
        scale = size / (high - low)
        offset = -0.5 - low * scale
        matrix = np.array([[scale[0], 0, offset[0]], [0, scale[1], offset[1]], [0, 0, 1]])
        image = Path(folder) / f"{number:05d}.png"
        cars.append(PosedCar(image, (int(size[0]), int(size[1])), "shape", matrix, rotation, translation))
    return cars


def make_small(source, monkeypatch):
    """Trainings of small networks on given photographs."""
    from fgrecon.perception.keypoints.layout import KNetSettings, RefineSettings
    from fgrecon_research.training.keypoints import networks, phases
    from fgrecon_research.training.keypoints.augment import Street

    small = {"warmup": 1, "save_every": 1, "street": Street(size=32), "network": KNetSettings(crop=32, width=8)}
    refined = {"network": RefineSettings(crop=64, width=4), "batch": 2, "save_every": 1}
    for module in (networks, phases):
        monkeypatch.setattr(module, "read_source", lambda data, marks: source)
    monkeypatch.setattr(networks, "Training", partial(networks.Training, **small))
    monkeypatch.setattr(networks, "RefineTraining", partial(networks.RefineTraining, **refined))
    monkeypatch.setattr(networks, "calibrate", partial(networks.calibrate, samples=6))
