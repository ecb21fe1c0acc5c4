"""What kinds of files have no place for: the table against what is written, part by part."""

import re
from dataclasses import replace

import numpy as np
import pytest

from fgrecon.core.geometry import AHEAD, rigid
from fgrecon.io.export import KINDS, ImageInfo, NamedResult, export
from fgrecon.io.export.formats import _KINDS, OF_FRAMES
from fgrecon.io.export.losses import LACKS, Part, not_written
from tests.results import changed
from tests.viz.made_up import make_example

ENDINGS = {kind: ending for kind, (ending, _) in _KINDS.items()}
EXTRAS = {"foxglove": "mcap", "vision_msgs": "mcap_ros2", "ros2": "mcap_ros2"}
INFO = ImageInfo(
    sample_token="315968867000000000",
    image_id=3,
    timestamp=1.5,
    world_T_camera=rigid(AHEAD, 0.0),
    sequence="log",
    world_T_vehicle=np.eye(4),
)


@pytest.fixture(scope="module")
def car():
    """A car with everything that a result can have."""
    made = make_example()
    camera = replace(made.camera, image_size=made.camera.image_size or (1242, 375))
    given = {"kind": "Van", "score": 0.75, "track": 8, "velocity": np.array([1.0, 2.0, 0.0])}
    result = changed(made.reconstruction, pose_covariance=np.eye(6) * 1e-4)
    box = np.array([300.0, 150.0, 420.0, 250.0])
    return NamedResult("7", result, box, image="street.png", camera=camera, **given)


def _moved(item, **values):
    return replace(item, result=changed(item.result, **values))


def _scaled(item, far):
    """As much larger as it is farther away: the same pixels."""
    pose, result = item.result.camera_T_object.copy(), item.result
    pose[:3, 3] *= far
    lines = {"wireframe": result.wireframe * far, "surface_vertices": result.shape.surface_vertices * far}
    return _moved(item, camera_T_object=pose, box_size=result.box_size * far, **lines)


def _leaning(item, about=0.0):
    """Turned about its axis ahead, through a point so far above its bottom."""
    turn = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(0.1), -np.sin(0.1)], [0.0, np.sin(0.1), np.cos(0.1)]])
    up = np.array([0.0, -about, 0.0])
    return _moved(item, camera_T_object=item.result.camera_T_object @ rigid(turn, up - turn @ up))


def _behind(item):
    pose = item.result.camera_T_object.copy()
    pose[:3, 3] = 0.3, 1.2, 0.5
    return _moved(item, camera_T_object=pose)


CHANGES = {
    Part.BOX: lambda item: _moved(item, box_size=item.result.box_size * 1.1),
    Part.METRES: lambda item: _scaled(item, 1.1),
    Part.LEAN: _leaning,
    Part.KEYPOINTS: lambda item: _moved(item, wireframe_uv=item.result.pose.wireframe_uv + 3.0),
    Part.HIDDEN: lambda item: _moved(item, visibility=1.0 - item.result.diagnostics.visibility),
    Part.DIGITS: lambda item: _moved(item, wireframe_uv=np.round(item.result.pose.wireframe_uv) + 0.2),
    Part.OUTSIDE: lambda item: _moved(item, wireframe_uv=item.result.pose.wireframe_uv - 3.0),
    Part.KIND: lambda item: replace(item, kind="Truck"),
    Part.SCORE: lambda item: replace(item, score=0.5),
    Part.TRACK: lambda item: replace(item, track=9),
    Part.VELOCITY: lambda item: replace(item, velocity=np.array([3.0, 2.0, 0.0])),
    Part.UNCERTAINTY: lambda item: _moved(item, pose_covariance=np.eye(6) * 2e-4),
}


def _written(tmp_path, kind, item):
    pytest.importorskip(EXTRAS.get(kind, "json"))
    content = export(tmp_path / f"a.{ENDINGS[kind]}", [item], kind, {"street.png": INFO}).read_bytes()
    if ENDINGS[kind] not in ("json", "xml", "csv", "txt"):
        return content, ()
    numbers = re.compile(r"(?<![\w.])-?\d+\.\d+(?:e-?\d+)?")
    return numbers.sub("#", content.decode()), [float(one) for one in numbers.findall(content.decode())]


def _same(one, other):
    return one[0] == other[0] and np.allclose(one[1], other[1], rtol=0.0, atol=1e-7)


def _starts(part, item):
    """What is compared with what has been changed."""
    if part is Part.DIGITS:
        return _moved(item, wireframe_uv=np.round(item.result.pose.wireframe_uv))
    if part is Part.OUTSIDE:
        return _moved(item, wireframe_uv=item.result.pose.wireframe_uv - 5000.0)
    if part is Part.BEHIND:
        return _behind(item)
    return item


def _keeps(part, kind, item, tmp_path):
    start = _starts(part, item)
    changes = [CHANGES[Part.BOX] if part is Part.BEHIND else CHANGES[part]]
    if part is Part.LEAN:  # some files place boxes by their bottom, some by their middle
        changes.append(lambda item: _leaning(item, item.result.box_size[2] / 2.0))
    before = _written(tmp_path, kind, start)
    return not any(_same(before, _written(tmp_path, kind, change(start))) for change in changes)


IMPLIED = {Part.BOX: (Part.METRES, Part.BEHIND, Part.LEAN), Part.KEYPOINTS: (Part.OUTSIDE, Part.HIDDEN, Part.DIGITS)}


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in OF_FRAMES])
def test_the_table_says_what_is_not_written(car, tmp_path, kind):
    lost = {part for part in Part if not _keeps(part, kind, car, tmp_path)}
    named = set(LACKS[kind])
    assert named <= lost
    assert lost <= named | {other for part in named for other in IMPLIED.get(part, ())}


def test_what_counts_is_what_the_vehicles_have(car):
    assert LACKS.keys() == set(KINDS)
    plain = replace(car, kind="Car", score=None, track=None, velocity=None)
    assert not_written("labelme", [car, plain]) == {
        Part.BOX: 2,
        Part.SCORE: 1,
        Part.TRACK: 1,
        Part.VELOCITY: 1,
        Part.UNCERTAINTY: 2,
    }
    assert not_written("nuscenes_tracking", [plain]) == {Part.KEYPOINTS: 1, Part.UNCERTAINTY: 1}
    assert not_written("cvat", [_behind(plain)])[Part.BEHIND] == 1
    assert Part.BEHIND not in not_written("cvat", [plain])
    outside = _starts(Part.OUTSIDE, plain)
    assert not_written("label_studio", [plain, outside])[Part.OUTSIDE] == 1
