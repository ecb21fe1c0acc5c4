"""`fgrecon evaluate paper` from the outside, on a small slice of the real data."""

import json
import shutil

import numpy as np
import pytest
from typer.testing import CliRunner

from fgrecon.calibration.labelled_frames import SceneKnowledge
from fgrecon.cli.main import app
from fgrecon.core.camera import Ground
from fgrecon.core.size_prior import size_prior
from fgrecon.io.catalogue import load_prior
from fgrecon_research.paper.simulated_run import CONDITIONS, PaperSettings, read_validation, run_conditions
from fgrecon_research.training.priors.apollo79 import load_apollo79

FRAMES = ["000035", "000499"]  # the second has no detection
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


@pytest.mark.data
@pytest.mark.slow
def test_a_small_run_is_whole_goes_on_and_does_not_depend_on_processes(few, tmp_path):
    out = tmp_path / "one"
    arguments = ["--data", str(few), "--out", str(out), "--workers", "1", "--no-progress"]
    result = CliRunner().invoke(app, ["evaluate", "paper", *arguments])
    assert result.exit_code == 0, result.output
    document = json.loads((out / "evaluation.json").read_text())
    text = (out / "evaluation.md").read_text()
    assert "<svg" in (out / "plots.svg").read_text()

    rows = {key: table["rows"] for key, table in document["tables"].items()}
    printed = {"table_1": "Pose", "table_2": "Shape", "table_2_real": "Shape", "table_3": "Pose"}
    for key, stage in printed.items():
        assert f"paper: {stage} adjustment" in rows[key]
    assert "paper: shape adjustment" in rows["table_4"]
    assert len(rows["per_part"]) == len(rows["per_part_real"]) == 14
    assert set(rows) >= {"known_shape", "real_tracks", "real_images", "network_images", "strategies", "kitti"}
    assert all(f"## {table['title']}\n" in text for table in document["tables"].values())
    easy_within_30 = rows["table_1"]["fgrecon, pose stage"][2]
    assert easy_within_30["value"] == 100.0
    assert rows["table_2_real"]["fgrecon, then both jointly"][0]["value"] > 50.0

    # what is wrong with the files is named and counted
    assert document["problems"] == {"missing frame": 1}
    assert "000499" in document["defects"][0]
    assert "Defects of the files: missing frame: 1." in text

    again(few, out / "parts", tmp_path / "two" / "parts")


def again(data, parts, folder):
    """What runs in parallel once more in two processes, a part of it taken over: the same numbers."""
    shutil.copytree(parts, folder)
    stored = sorted(path.relative_to(parts) for path in parts.rglob("*.npz"))
    kept = [path for path in stored if path.parts[0].startswith("harder")]
    assert kept
    for path in set(stored) - set(kept):
        (folder / path).unlink()
    models = load_apollo79(data)
    scene = SceneKnowledge(load_prior("car14"), Ground.level(1.65), size_prior("kitti"))
    validation = read_validation(data / "kitti_object")
    settings = PaperSettings(data, folder.parent, scene, workers=2)
    outcomes = run_conditions(validation, CONDITIONS, models, settings)
    assert {name for name, outcome in outcomes.items() if not outcome.solved} == {"harder"}
    assert sorted(path.relative_to(folder) for path in folder.rglob("*.npz")) == stored
    for path in stored:
        with np.load(parts / path) as first, np.load(folder / path) as second:
            assert first.files == second.files
            for name in first.files:
                np.testing.assert_array_equal(first[name], second[name])
