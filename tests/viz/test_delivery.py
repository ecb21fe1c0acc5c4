"""Recordings of several vehicles: each in its own file, whole or not at all; an error in any of them is reported."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from rerun.chunk import RrdReader

from fgrecon.core.errors import InvalidInputError
from fgrecon.viz import Recording, SolvedVehicle, entities, recording_of, replay
from fgrecon.viz.recording import recordings_of
from fgrecon.viz.sinks import deliver
from tests.results import changed
from tests.viz.made_up import Example, make_example


@pytest.fixture(scope="module")
def example() -> Example:
    return make_example()


def recordings(example: Example, count: int) -> list[tuple[str, Recording]]:
    """Recordings that differ in the length of their history."""
    results = [
        changed(example.reconstruction, history=example.reconstruction.diagnostics.history[: 3 + i])
        for i in range(count)
    ]
    return [
        (f"car {i}", recording_of(SolvedVehicle(r, example.observation, example.camera))) for i, r in enumerate(results)
    ]


def test_every_vehicle_has_its_file(example: Example, tmp_path: Path) -> None:
    written = deliver(recordings(example, 4), tmp_path / "cars.rrd", None, spawn=False, several=True)
    assert [path.name for path in written] == [f"cars-car-{i}.rrd" for i in range(4)]
    assert sorted(tmp_path.iterdir()) == written
    assert [len(replay.read(path).history) for path in written] == [3, 4, 5, 6]


def test_the_photograph_of_several_vehicles_is_encoded_once(
    example: Example, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    encoded = []
    encode = cv2.imencode
    monkeypatch.setattr(cv2, "imencode", lambda *given: encoded.append(given) or encode(*given))
    other = 255 - example.image
    sights = [
        SolvedVehicle(example.reconstruction, example.observation, example.camera, image=image, title=f"car {i}")
        for i, image in enumerate((example.image, other, example.image, None))
    ]
    written = deliver(recordings_of(sights, None), tmp_path / "cars.rrd", None, spawn=False, several=True)
    assert len(encoded) == 2
    shown = [
        [
            chunk.to_record_batch().to_pydict()["EncodedImage:blob"][0][0]
            for chunk in RrdReader(path).stream()
            if str(chunk.entity_path).strip("/") == entities.IMAGE and not chunk.is_static
        ]
        for path in written
    ]
    assert [len(photographs) for photographs in shown] == [1, 1, 1, 0]
    assert shown[0] == shown[2] != shown[1]
    (jpeg,) = shown[1]
    found = cv2.imdecode(np.array(jpeg, dtype=np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    assert np.abs(found.astype(float) - other).mean() < 10.0


def test_vehicles_of_one_name_have_two_files(example: Example, tmp_path: Path) -> None:
    named = [("a car", recording) for _, recording in recordings(example, 2)]
    written = deliver(named, tmp_path / "cars.rrd", None, spawn=False, several=True)
    assert [path.name for path in written] == ["cars-a-car.rrd", "cars-a-car-2.rrd"]
    assert [len(replay.read(path).history) for path in written] == [3, 4]


def test_a_file_that_cannot_be_written_is_reported_and_leaves_nothing(example: Example, tmp_path: Path) -> None:
    (tmp_path / "cars-car-1.rrd").mkdir()
    with pytest.raises(InvalidInputError, match="cars-car-1"):
        deliver(recordings(example, 3), tmp_path / "cars.rrd", None, spawn=False, several=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["cars-car-0.rrd", "cars-car-1.rrd"]
    assert len(replay.read(tmp_path / "cars-car-0.rrd").history) == 3


def test_an_error_while_it_is_put_in_its_place_is_reported(
    example: Example, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(self: Path, target: Path) -> Path:
        raise OSError(28, "No space left on device", str(target))

    monkeypatch.setattr(Path, "replace", refuse)
    with pytest.raises(InvalidInputError, match="No space left"):
        deliver(recordings(example, 2), tmp_path / "cars.rrd", None, spawn=False, several=True)
    assert not list(tmp_path.iterdir())
