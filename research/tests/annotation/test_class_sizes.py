"""`fgrecon prior sizes`: sizes of classes by label files, and what the detector calls them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from fgrecon.cli import main
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.catalogue import shipped_class_sizes
from fgrecon.io.kitti_files import Objects
from fgrecon_research.annotation import class_sizes

SIZES = {"Car": (3.9, 1.6, 1.5), "Van": (5.0, 1.9, 2.2), "Truck": (10.0, 2.6, 3.3), "Tram": (16.0, 2.4, 3.5)}


def labels(folder: Path, sizes: Mapping[str, tuple[float, float, float]] = SIZES) -> Path:
    folder.mkdir()
    for number in range(5):
        lines = [
            f"{kind} 0 0 0 1 2 30 40 {height + 0.1 * number} {width} {length + 0.2 * number} 1 1 9 0"
            for kind, (length, width, height) in sizes.items()
        ]
        (folder / f"{number:06d}.txt").write_text("\n".join([*lines, "Pedestrian 0 0 0 1 2 3 4 1 1 1 1 1 9 0"]) + "\n")
    return folder


def test_sizes_are_those_of_the_labels(tmp_path: Path) -> None:
    found = class_sizes.class_sizes(labels(tmp_path / "label_2"))
    assert tuple(found) == class_sizes.CLASSES
    assert found["car"]["mean"] == pytest.approx([4.3, 1.6, 1.7])
    assert found["lorry"]["count"] == 5
    assert sum(one["share"] for one in found.values()) == pytest.approx(1.0)
    assert found["van"]["covariance"][0][2] == pytest.approx(0.05, abs=1e-3)  # both grow from file to file
    assert found["bus"]["share"] == 0.0  # KITTI has none
    with pytest.raises(InvalidInputError, match="too few are of a tram"):
        class_sizes.class_sizes(labels(tmp_path / "few", {kind: SIZES[kind] for kind in ("Car", "Van", "Truck")}))


def numbers(*margins: float) -> np.ndarray:
    """(M, 4) of a detector that takes a vehicle so much more for a truck than for a car."""
    return np.array([[0.0, -9.0, -9.0, margin] for margin in margins])


def test_labelled_vehicles_are_what_the_detector_sees(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    boxes = np.array([[100.0, 100, 200, 160], [300, 100, 380, 180], [500, 100, 520, 120]])
    objects = Objects.detections(["Car", "Van", "Truck"], boxes, np.ones(3))
    frames = [SimpleNamespace(image=Path("a.png"), objects=objects, tracks=np.array([4, 5, 6])) for _ in range(10)]
    drive = SimpleNamespace(name="drive", frames=frames)
    detector = SimpleNamespace(class_numbers=lambda _, boxes: [numbers(-2.0)[0], numbers(1.0)[0], None])
    monkeypatch.setattr(class_sizes, "NanodetVehicleDetector", lambda: detector)
    monkeypatch.setattr(class_sizes, "read_images", lambda _: drive)
    monkeypatch.setattr(class_sizes, "read_image", lambda _: None)
    monkeypatch.setattr(class_sizes, "Selection", lambda **_: SimpleNamespace(judge=lambda _: (np.arange(3), None)))
    seen = class_sizes.detected_vehicles([tmp_path])
    assert [(one.kind, one.numbers.shape) for one in seen] == [("car", (10, 4)), ("van", (10, 4))]
    found = class_sizes.detector_classes(seen, dict.fromkeys(class_sizes.CLASSES, 0.2))
    assert found["car"]["car"] == pytest.approx((0.2 + 1 + 1) / 3, abs=1e-3)  # prior, meaning, one car
    assert found["truck"]["van"] == pytest.approx((0.2 + 1) / 3, abs=1e-3)
    assert found["truck"]["lorry"] == pytest.approx((0.2 + 1) / 3, abs=1e-3)
    assert found["bus"]["bus"] == pytest.approx(1.2 / 2, abs=1e-3)


def test_the_odds_of_a_van_are_a_logistic_regression() -> None:
    rng = np.random.default_rng(1)
    margins = rng.normal(size=20000) * 2.0
    is_van = rng.random(len(margins)) < 1.0 / (1.0 + np.exp(-(0.5 + 2.0 * margins)))
    groups = np.array_split(margins[is_van], 1000), np.array_split(margins[~is_van], 1000)
    seen = [
        class_sizes.DetectedVehicle(kind, numbers(*some))
        for kind, each in zip(("van", "car"), groups, strict=True)
        for some in each
    ]
    share = {"car": float((~is_van).mean()), "van": float(is_van.mean())}
    assert class_sizes.detector_odds(seen, share) == pytest.approx({"offset": 0.5, "slope": 2.0}, abs=0.1)
    rarer = class_sizes.detector_odds(seen, {**share, "van": 0.1 * share["van"]})
    assert rarer == pytest.approx({"offset": 0.5 - np.log(10.0), "slope": 2.0}, abs=0.2)
    with pytest.raises(InvalidInputError, match=r"drives.*no car or no van"):
        class_sizes.detector_odds(seen[:10], share)


def test_the_command_writes_what_is_shipped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = [class_sizes.DetectedVehicle("car", numbers(-2.0)), class_sizes.DetectedVehicle("van", numbers(0.0))]
    monkeypatch.setattr(class_sizes, "detected_vehicles", lambda _: seen)
    folder, out = labels(tmp_path / "label_2"), tmp_path / "kitti.json"
    done = CliRunner().invoke(main.app, ["prior", "sizes", str(tmp_path), "--labels", str(folder), "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert "van: 5 labels, 5.40 x 1.90 x 2.40 m" in done.stdout
    content = json.loads(out.read_text())
    shipped = shipped_class_sizes()
    assert tuple(content["classes"]) == tuple(shipped.mean)
    assert {name: one["shape"] for name, one in content["classes"].items() if "shape" in one} == shipped.coarse
    assert set(content["schemes"]) == set(shipped.schemes)
    assert set(content["detector"]) == {"offset", "slope"}
    assert content["schemes"]["nuscenes"]["car"] == {"car": 0.5, "van": 0.5}
