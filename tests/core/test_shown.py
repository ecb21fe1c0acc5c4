"""Results and other data show themselves in a few lines, as tables, and by a plotting backend."""

import importlib.metadata
import io
import sys
from types import SimpleNamespace

import numpy as np
import pyarrow.parquet as pq
import pytest

from fgrecon.core import plotting
from fgrecon.core.errors import InvalidInputError, MissingPackageError
from fgrecon.core.observation import Observation
from fgrecon.core.plotting import plotting_backend
from fgrecon.core.reconstruction import Status
from fgrecon.core.text import counted
from fgrecon.core.track_reconstruction import JointStep, TrackReconstruction
from fgrecon.io.catalogue import load_prior
from fgrecon.io.export.results import NamedResult
from fgrecon.io.export.table import csv_text, parquet_bytes
from tests.core.test_reconstruction import made_up
from tests.results import changed


def made_up_track():
    frames = tuple(made_up(np.random.default_rng(seed)) for seed in (0, 1))
    step = JointStep(0, 0, np.zeros((2, 4, 4)), np.zeros(5), {"box": 1.0})
    return TrackReconstruction(
        Status.CONVERGED, "Both share one shape.", (0, 2), frames, {1: "none"}, {}, (step,), (), {"joint": 9.0}
    )


def test_a_result_is_shown_in_a_few_lines():
    result = made_up(np.random.default_rng(0))
    lines = repr(result).splitlines()
    assert lines[0] == "Reconstruction: ambiguous. Why not — ümlauts, too."
    assert lines[1] == "  rotation_y 22.9 degrees, location (1.50, 1.65, 12.00) m"
    length, width, height = result.box_size
    assert lines[2] == f"  length {length:.2f} m, width {width:.2f} m, height {height:.2f} m"
    assert lines[3] == "  1 of 4 keypoints trusted, prior made up, 2 ms"
    assert len(lines) == 4


def test_a_result_of_an_image_has_no_time_of_its_own():
    assert repr(changed(made_up(np.random.default_rng(0)), milliseconds={})).endswith("trusted, prior made up")


@pytest.mark.parametrize(("count", "expected"), [(0, "0 boxes"), (1, "1 box"), (2, "2 boxes")])
def test_one_thing_is_no_things(count, expected):
    assert counted(count, "box", "boxes") == expected
    assert counted(count, "car") == f"{count} car{'' if count == 1 else 's'}"


def test_a_result_without_a_pose_is_shown_as_well():
    result = made_up(np.random.default_rng(0))
    object.__setattr__(result.pose, "camera_T_object", np.full((4, 4), np.nan))
    assert len(repr(result).splitlines()) == 2


def test_a_track_is_shown_in_a_few_lines():
    lines = repr(made_up_track()).splitlines()
    assert lines[0] == "TrackReconstruction: converged. Both share one shape."
    assert lines[1] == "  2 images solved, 1 refused"
    assert lines[-1] == "  1 joint step, 9 ms"


def test_data_with_large_arrays_is_shown_in_a_line():
    prior, result, track = load_prior("car14"), made_up(np.random.default_rng(0)), made_up_track()
    seen = Observation(np.zeros((14, 2)), np.ones(14), np.array([1.0, 2.0, 30.0, 40.5]))
    for value in (
        prior,
        prior.category,
        prior.surface,
        result.diagnostics.history[0],
        result.uncertainty.alternatives[0],
        track.history[0],
    ):
        assert len(repr(value)) < 800
        assert "\n" not in repr(value)
        assert repr(value).startswith(type(value).__name__ + "(")
    assert repr(seen).startswith("Observation(keypoints=float64 (14, 2), confidence=float64 (14,), box=[ 1. ,  2. ,")


def test_columns_are_those_of_exported_files():
    result = made_up(np.random.default_rng(0))
    named = [NamedResult("a", result)]
    given = ["image", "kind", "score", "track", "x1", "y1", "x2", "y2"]
    first, *rest = result.to_row("a")
    assert [first, *given, *rest] == csv_text(named).splitlines()[0].split(",")
    table = result.to_arrow("a")
    assert table.equals(pq.read_table(io.BytesIO(parquet_bytes(named))).drop_columns(given))
    assert table.column("x")[0].as_py() == result.location[0]


def test_a_track_has_a_row_for_each_image():
    track = made_up_track()
    table = track.to_arrow()
    assert table.column("id").to_pylist() == ["0", "2"]
    np.testing.assert_array_equal(table.column("weights")[1].as_py(), track.frames[1].diagnostics.weights)


def test_tables_of_pandas():
    pytest.importorskip("pandas")
    result, track = made_up(np.random.default_rng(0)), made_up_track()
    frame = result.to_pandas("a")
    assert list(frame.columns) == list(result.to_row())
    assert frame.loc[0, "id"] == "a"
    assert frame.loc[0, "rotation_y"] == result.rotation_y
    assert list(track.to_pandas()["id"]) == ["0", "2"]


def test_ids_that_are_no_text_have_replacement_characters():
    result = made_up(np.random.default_rng(0))
    assert result.to_arrow("n\udcff").column("id").to_pylist() == ["n\ufffd"]
    pytest.importorskip("pandas")
    assert result.to_pandas("n\udcff").loc[0, "id"] == "n\ufffd"


def test_without_pandas_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(MissingPackageError, match="pip install pandas") as caught:
        made_up(np.random.default_rng(0)).to_pandas()
    assert caught.value.package == "pandas"
    assert isinstance(caught.value, ImportError)


def pretend(monkeypatch, **backends):
    points = [SimpleNamespace(name=name, load=lambda module=module: module) for name, module in backends.items()]
    known = {"fgrecon.plotting": points}
    monkeypatch.setattr("importlib.metadata.entry_points", lambda group: known.get(group, []))


def test_a_result_draws_by_the_backend_that_is_asked_for(monkeypatch):
    calls = []
    drawn = SimpleNamespace(
        plot=lambda result, image, *, observation: calls.append((result, image, observation)) or "figure",
        plot_track=lambda track, images: calls.append((track, images)) or "sheet",
        html=lambda result: "<b>html</b>",
    )
    pretend(monkeypatch, matplotlib=drawn, other=SimpleNamespace(plot=lambda *_, **__: "another"))
    result, track = made_up(np.random.default_rng(0)), made_up_track()
    assert result.plot("street.png") == "figure"
    assert track.plot() == "sheet"
    assert calls == [(result, "street.png", None), (track, None)]
    assert result.plot(backend="other") == "another"
    assert result._repr_html_() == track._repr_html_() == "<b>html</b>"
    with pytest.raises(InvalidInputError, match="matplotlib, other"):
        result.plot(backend="third")


def test_without_a_backend_drawing_says_so_and_showing_goes_on(monkeypatch):
    pretend(monkeypatch)
    result = made_up(np.random.default_rng(0))
    with pytest.raises(MissingPackageError, match=r"fgrecon\.plotting.*pip install fgrecon"):
        result.plot()
    assert result._repr_html_().startswith("<pre>Reconstruction: ambiguous.")


def test_the_backend_of_fgrecon_is_registered():
    assert "matplotlib" in {point.name for point in importlib.metadata.entry_points(group=plotting.GROUP)}
    assert plotting_backend().__name__ == "fgrecon.viz.notebook"
