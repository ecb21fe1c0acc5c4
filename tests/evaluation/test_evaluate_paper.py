"""`fgrecon evaluate paper` from the outside, on a small slice of the real data."""

import json
import shutil

import pytest
from typer.testing import CliRunner

from fgrecon.cli.main import app

FRAMES = ["000004", "000499"]  # the second has no detection
RARE = 27  # number of a model of which there are two cars
DETECTIONS = "detections_2d/rgb_detection_val.txt"
NEEDED = (
    *("apollo79/apollo79_car14.npz", "apollocar3d_val/annotations.json", "kitti_tracking_keypoints14"),
    *("hand_labels/kitti_object_keypoints14.json", "kitti_object/training/image_2", f"kitti_object/{DETECTIONS}"),
)


def link(source, target):
    target.parent.mkdir(parents=True, exist_ok=True)
    target.symlink_to(source)


@pytest.fixture(scope="module")
def real(data):
    missing = [name for name in NEEDED if not (data / name).exists()]
    if missing:
        pytest.skip(f"the data lack {missing[0]}")
    return data.resolve()


@pytest.fixture(scope="module")
def few(real, tmp_path_factory):
    """Two frames, two cars marked by hand, two frames of a track, and two cars of known shape."""
    data = tmp_path_factory.mktemp("data")
    link(real / "apollo79", data / "apollo79")
    link(real / "kitti_object" / "training", data / "kitti_object" / "training")
    for name, lines in (("ImageSets/val.txt", FRAMES), (DETECTIONS, detections(real / "kitti_object" / DETECTIONS))):
        path = data / "kitti_object" / name
        path.parent.mkdir()
        path.write_text("".join(f"{line}\n" for line in lines))
    write(data, real, "hand_labels/kitti_object_keypoints14.json", lambda cars: cars[:2])
    write(data, real, "apollocar3d_val/annotations.json", rare_cars)
    track = sorted((real / "kitti_tracking_keypoints14").glob("*.json"))[0].relative_to(real)
    write(data, real, track, lambda content: {**content, "frames": content["frames"][:2]})
    return data


def detections(path):
    """The frames' lines: each begins with the path of the image."""
    return [line for line in path.read_text().splitlines() if any(f"{frame}." in line for frame in FRAMES)]


def write(data, real, name, change):
    path = data / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(change(json.loads((real / name).read_text()))))


def rare_cars(content):
    """The first images of one model's cars, without the others."""
    content["images"] = [
        {**image, "cars": [c for c in image["cars"] if c["cad_id"] == RARE]} for image in content["images"]
    ]
    return content


def evaluate(data, out, workers):
    result = CliRunner().invoke(
        app, ["evaluate", "paper", "--data", str(data), "--out", str(out), "--workers", str(workers), "--no-progress"]
    )
    assert result.exit_code == 0, result.output
    return json.loads((out / "evaluation.json").read_text())


def numbers(document):
    """Everything but run times."""
    tables = {}
    for key, table in document["tables"].items():
        if key == "table_4":
            continue
        timed = {i for i, column in enumerate(table["columns"]) if column == "ms"}
        tables[key] = {row: [c for i, c in enumerate(cells) if i not in timed] for row, cells in table["rows"].items()}
    return tables, document["claims"], document["failures"], document["defects"]


@pytest.mark.data
@pytest.mark.slow
def test_a_small_run_is_whole_goes_on_and_does_not_depend_on_processes(few, tmp_path):
    first = evaluate(few, tmp_path / "one", 1)
    for name in ("evaluation.md", "evaluation.json", "evaluation.html"):
        assert (tmp_path / "one" / name).stat().st_size > 10_000
    rows = {key: list(table["rows"]) for key, table in first["tables"].items()}
    assert "paper: Pose adjustment" in rows["table_1"]
    assert "paper: Shape adjustment" in rows["table_2"]
    assert "paper: Shape adjustment" in rows["table_2_real"]
    assert "paper: Mono3D" in rows["table_3"]
    assert "paper: shape adjustment" in rows["table_4"]
    assert len(rows["per_part"]) == len(rows["per_part_real"]) == 14
    assert set(rows) >= {"known_shape", "real_tracks", "real_images", "network_images", "strategies", "kitti"}
    assert any(
        isinstance(cell, dict) and cell["value"] > 0
        for cell in first["tables"]["table_1"]["rows"]["fgrecon, pose stage"]
    )
    # what is wrong with the files is named and counted
    assert first["problems"] == {"missing frame": 1}
    assert "000499" in first["defects"][0]
    text = (tmp_path / "one" / "evaluation.md").read_text()
    assert "Defects of the files: missing frame: 1." in text
    assert text.count("\n## ") >= len(rows)

    # another number of processes, half of the work taken over from the first run
    shutil.copytree(tmp_path / "one" / "parts", tmp_path / "two" / "parts")
    removed = [part for n, part in enumerate(sorted((tmp_path / "two" / "parts").rglob("*.npz"))) if n % 2]
    assert removed
    for part in removed:
        part.unlink()
    second = evaluate(few, tmp_path / "two", 2)
    assert numbers(second) == numbers(first)
    assert 0 < second["throughput"]["instances"] < first["throughput"]["instances"]
