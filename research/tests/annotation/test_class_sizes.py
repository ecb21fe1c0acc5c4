"""`fgrecon prior sizes`: sizes of classes by label files, and what the detector calls them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from fgrecon import VehicleClass, Vehicles
from fgrecon.cli import main
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.size_prior import CLASSES
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
    assert tuple(found) == CLASSES
    assert found["car"]["mean"] == pytest.approx([4.3, 1.6, 1.7])
    assert found["lorry"]["count"] == 5
    assert sum(one["share"] for one in found.values()) == pytest.approx(1.0)
    assert found["van"]["covariance"][0][2] == pytest.approx(0.05, abs=1e-3)  # both grow from file to file
    assert found["bus"]["share"] == 0.0  # KITTI has none
    with pytest.raises(InvalidInputError, match="too few are of a tram"):
        class_sizes.class_sizes(labels(tmp_path / "few", {kind: SIZES[kind] for kind in ("Car", "Van", "Truck")}))


def test_the_detectors_names_are_counted_once_a_vehicle(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    boxes = np.array([[100.0, 100, 200, 160], [300, 100, 380, 180]])
    objects = Objects.detections(["Car", "Van"], boxes, np.ones(2))
    frames = [SimpleNamespace(image=Path("a.png"), objects=objects, tracks=np.array([4, 5])) for _ in range(10)]
    drive = SimpleNamespace(name="drive", frames=frames)
    called = VehicleClass("car", "coco"), VehicleClass("truck", "coco")

    def detector(image: Any, least_score: float) -> Vehicles:
        return Vehicles(boxes, np.ones(2), classes=called)

    monkeypatch.setattr(class_sizes, "NanodetVehicleDetector", lambda: detector)
    monkeypatch.setattr(class_sizes, "read_images", lambda _: drive)
    monkeypatch.setattr(class_sizes, "read_image", lambda _: None)
    judge = SimpleNamespace(judge=lambda _: (np.arange(2), None))
    monkeypatch.setattr(class_sizes, "Selection", lambda **_: judge)
    share = dict.fromkeys(CLASSES, 0.2)
    found = class_sizes.detector_classes([tmp_path], share)
    assert found["car"]["car"] == pytest.approx((0.2 + 1 + 1) / 3, abs=1e-3)  # prior, meaning, one car
    assert found["truck"]["van"] == pytest.approx((0.2 + 1) / 3, abs=1e-3)
    assert found["truck"]["lorry"] == pytest.approx((0.2 + 1) / 3, abs=1e-3)
    assert found["bus"]["bus"] == pytest.approx(1.2 / 2, abs=1e-3)


def test_the_command_writes_what_is_shipped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(class_sizes, "detector_classes", lambda *_: {"car": {"car": 1.0}})
    folder, out = labels(tmp_path / "label_2"), tmp_path / "kitti.json"
    done = CliRunner().invoke(main.app, ["prior", "sizes", str(tmp_path), "--labels", str(folder), "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert "van: 5 labels, 5.40 x 1.90 x 2.40 m" in done.stdout
    content = json.loads(out.read_text())
    shipped = shipped_class_sizes()
    assert tuple(content["classes"]) == tuple(shipped.mean)
    assert set(content["schemes"]) == set(shipped.schemes)
    assert content["schemes"]["nuscenes"]["car"] == {"car": 0.5, "van": 0.5}
