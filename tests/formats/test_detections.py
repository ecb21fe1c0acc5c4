"""A detector's boxes for a data set: placed in its images, and written back where they were."""

import json
from dataclasses import replace

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.reconstruction import rotation_y
from fgrecon.io.box_lines import BoxedImage
from fgrecon.io.datasets import open_sequence
from fgrecon.io.datasets.detections import read_detections
from fgrecon.perception.refine_files import open_boxes

from . import made_up
from .test_datasets import CAMERAS, ROOTS, WRITERS

KITS = {"argoverse2": "d.feather", "nuscenes": "d.json", "truckscenes": "d.json", "zod": "d.json"}


def _rows(name, sequence):
    """The labels as detections, two of them behind the camera."""
    for moment in sequence.moments.values():
        frame_T_world = np.linalg.inv(moment.world_T_vehicle) if name in ("argoverse2", "zod") else np.eye(4)
        for box in moment.boxes:
            yield moment, box, frame_T_world @ box.world_T_box


def _write(path, name, sequence):
    if name == "argoverse2":
        import pyarrow as pa
        from pyarrow import feather

        rows = []
        for moment, box, pose in _rows(name, sequence):
            about = {"timestamp_ns": int(moment.name), "log_id": sequence.name, "category": box.kind, "score": 0.75}
            about |= dict(zip(("length_m", "width_m", "height_m"), box.size.tolist(), strict=True))
            about |= dict(zip(("qw", "qx", "qy", "qz"), made_up.wxyz(pose), strict=True))
            rows.append(about | dict(zip(("tx_m", "ty_m", "tz_m"), pose[:3, 3].tolist(), strict=True)))
        rows.append({**rows[0], "log_id": "another"})
        feather.write_feather(pa.Table.from_pylist(rows), path)
        return
    results = {}
    for moment, box, pose in _rows(name, sequence):
        length, width, height = box.size.tolist()
        token = moment.name.rpartition("/")[2]
        entry = {"sample_token": token, "translation": pose[:3, 3].tolist(), "size": [width, length, height]}
        kind = "Vehicle_Car" if name == "zod" else "car"
        entry |= {"rotation": made_up.wxyz(pose), "detection_name": kind, "detection_score": 0.75, "x": "kept"}
        results.setdefault(token, []).append(entry)
    path.write_text(json.dumps({"results": {"elsewhere": [{"sample_token": "elsewhere"}], **results}}))


@pytest.fixture(params=KITS)
def written(request, tmp_path):
    name = request.param
    WRITERS[name](tmp_path / "data")
    source = f"{tmp_path / 'data' / ROOTS.get(name, '')}#{CAMERAS[name]}"
    sequence, _ = open_sequence(source)
    path = tmp_path / KITS[name]
    _write(path, name, sequence)
    return name, path, source, sequence


def _entries(path, content):
    if path.suffix == ".feather":
        from io import BytesIO

        from pyarrow import feather

        return feather.read_table(BytesIO(content)).to_pylist()
    return [entry for entries in json.loads(content)["results"].values() for entry in entries]


def _plain(entry):
    return {
        key: pytest.approx(value, abs=1e-9) if not isinstance(value, str) else value for key, value in entry.items()
    }


def test_boxes_are_placed_and_come_back(written):
    name, path, source, sequence = written
    found = read_detections(path, *open_sequence(source))
    before = _entries(path, path.read_bytes())
    images = [image for image in found.images if image.objects]
    assert len(images) == (1 if name == "zod" else 2)
    assert all(isinstance(image, BoxedImage) and image.camera.image_size == (1600, 900) for image in images)
    labels = {tuple(np.round(b.size, 6)): b for moment in sequence.moments.values() for b in moment.boxes}
    changed = {}
    for image in images:
        assert len(image.objects) == 3  # one is behind the camera, the middle of one beside the image
        for box in image.objects:
            assert box.score == 0.75
            assert box.kind in ("Car", "car")
            seen, same = box.box(np.zeros(3)), labels[tuple(np.round(box.size, 6))]
            assert abs(np.linalg.norm(box.world_T_object[:3, 3] - same.world_T_box[:3, 3])) < 0.5  # two moments
            pose = np.linalg.inv(box.world_T_camera) @ box.world_T_object
            assert seen.rotation_y == pytest.approx(rotation_y(pose))
            again = box.with_box(seen, np.zeros(3))
            assert again == _plain(before[box.number])
            farther = replace(seen, location=np.add(seen.location, [0.0, 0.0, 1.0]))
            changed[box.number] = box.with_box(farther, np.zeros(3))
    after = _entries(path, found.content(changed))
    assert len(after) == len(before)
    for number, (old, new) in enumerate(zip(before, after, strict=True)):
        places = [one.get("translation") or [one.get(f"t{axis}_m", 0.0) for axis in "xyz"] for one in (old, new)]
        assert np.linalg.norm(np.subtract(*places)) == pytest.approx(float(number in changed))


def test_refine_opens_them_with_images_and_cameras(written, tmp_path):
    _, path, source, _ = written
    files = open_boxes(path, source, tmp_path / f"out{path.suffix}", None)
    assert any(image.image is not None and image.image.is_file() and image.objects for image in files.images)


def test_boxes_of_other_images_are_refused(written):
    name, path, source, _ = written
    if name == "zod":
        other = source.replace("000000/front_blur", "000001/front_blur")
        data = json.loads(path.read_text())
        path.write_text(json.dumps({"results": {"elsewhere": data["results"]["elsewhere"]}}))
        with pytest.raises(InvalidInputError, match="Give images that show boxes of"):
            read_detections(path, *open_sequence(other))
    elif name == "argoverse2":
        import pyarrow as pa
        from pyarrow import feather

        rows = feather.read_table(path).to_pylist()
        for wrong in ([1.0], True, "wide"):
            feather.write_feather(pa.Table.from_pylist([{**row, "score": wrong} for row in rows]), path)
            with pytest.raises(InvalidInputError, match=r"d.feather: score.*no numbers"):
                read_detections(path, *open_sequence(source))
        path.write_bytes(b"none")
        with pytest.raises(InvalidInputError, match=r"d.feather.*whole"):
            read_detections(path, *open_sequence(source))
    else:
        path.write_text(path.read_text().replace("detection_name", "name"))
        with pytest.raises(InvalidInputError, match=r"results\.s0\[0\]\.detection_name"):
            read_detections(path, *open_sequence(source))
