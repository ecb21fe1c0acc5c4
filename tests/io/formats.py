"""A made-up car in the layouts of other programs, and files with something wrong in them."""

import copy
import json

import numpy as np
from hypothesis import strategies as st
from scipy.io import savemat

import fgrecon
from fgrecon.core.camera import Camera
from fgrecon.io.catalogue import load_category, load_prior
from fgrecon.io.keypoints.names import parse_names, scheme_keypoints
from fgrecon.simulation.vehicles import yaw_pose

CATEGORY = load_category("car14")
CAMERA = Camera(np.array([[700.0, 0.0, 600.0], [0.0, 710.0, 180.0], [0.0, 0.0, 1.0]]), image_size=(1242, 375))
MISSING = 3, 11
"""Keypoints that nobody found."""


def car(yaw=-2.2, location=(-2.0, 1.65, 11.0)):
    """Pixels (14, 2) and box (4,) of the mean car, with two digits as files have them."""
    prior, pose = load_prior("car14"), yaw_pose(yaw, np.array(location))
    pixels, outline = (CAMERA.project(points @ pose[:3, :3].T + pose[:3, 3]) for points in (prior.mean, surface(prior)))
    return np.round(pixels, 2), np.round(np.concatenate([outline.min(0), outline.max(0)]), 2)


def surface(prior):
    return prior.surface.mean


def our_record(points, confidence, box=None, **more):
    """The instance in fgrecon's own layout: the points but for those that are missing."""
    record = {
        "keypoints": {
            name: [*map(float, points[k]), confidence]
            for k, name in enumerate(CATEGORY.keypoints)
            if np.isfinite(points[k]).all() and k not in MISSING
        }
    }
    return record | ({} if box is None else {"box": [float(x) for x in box]}) | more


def in_scheme(points, scheme):
    """(P, 2) the points in the order of a scheme, NaN where it has others; all of a group where ours is.

    Only what the scheme can tell of: our keypoints without a group are lost.
    """
    names = scheme_keypoints(scheme)
    array = np.full((len(names), 2), np.nan)
    for ours, theirs in parse_names(scheme, CATEGORY).groups.items():
        k = CATEGORY.index(ours)
        if k not in MISSING:
            for name in theirs:
                array[names.index(name)] = points[k]
    return array


def given_by(scheme, points):
    """Our points (14, 2) of which a scheme has any; NaN elsewhere."""
    groups = parse_names(scheme, CATEGORY).groups
    return np.array([points[k] if name in groups else [np.nan] * 2 for k, name in enumerate(CATEGORY.keypoints)])


def pascal_file(path, points, box):
    """A file of PASCAL3D+, which counts pixels from 1: a car, and a dog."""
    anchors = {
        name: {"location": point + 1, "status": 1} if np.isfinite(point).all() else {"location": [], "status": 2}
        for name, point in zip(scheme_keypoints("pascal12"), in_scheme(points, "pascal12"), strict=True)
    }
    dtype = [("class", object), ("bbox", object), ("anchors", object)]
    objects = np.array([("car", box + 1, anchors), ("dog", box + 1, np.zeros(0))], dtype=dtype)
    savemat(path, {"record": {"filename": f"{path.stem}.jpg", "objects": objects}})
    return path


def flat(points, confidence):
    """u, v, confidence one after the other; three zeros where there is no point."""
    return [float(x) for u, v in points for x in ([u, v, confidence] if np.isfinite(u) else [0, 0, 0])]


def same(found, expected):
    """Whether two instances have the same evidence, and the solver the same answer for both."""
    a, b = found.observation, expected.observation
    for field in ("keypoints", "confidence", "box", "covariance"):
        one, other = getattr(a, field), getattr(b, field)
        assert (one is None) == (other is None), field
        assert one is None or np.array_equal(one, other, equal_nan=True), field
    assert a.confidence_midpoint == b.confidence_midpoint
    first, second = (fgrecon.reconstruct(o, CAMERA) for o in (a, b))
    assert first.status is second.status is fgrecon.Status.CONVERGED
    assert np.array_equal(first.camera_T_object, second.camera_T_object)
    return first


def write(path, content):
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


_LEAVES = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3) | st.just([]) | st.just({})
VALUES = st.recursive(
    _LEAVES, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=2)
)
"""Anything that JSON and YAML can hold."""


@st.composite
def spoilt(draw, document):
    """The document with one value anywhere in it replaced, or left out."""
    content = copy.deepcopy(document)
    place, key = None, None
    inner = content
    while isinstance(inner, dict | list) and inner and (place is None or draw(st.integers(0, 5))):
        place, key = inner, draw(st.sampled_from(sorted(inner) if isinstance(inner, dict) else range(len(inner))))
        inner = place[key]
    if place is None or draw(st.integers(0, 9)) == 0:
        return draw(VALUES)
    if draw(st.booleans()):
        del place[key]
    else:
        place[key] = draw(VALUES)
    return content
