"""Layouts: one in every file, zoomed to its own vehicle, of classes that any release of rerun has."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

from fgrecon.viz import SolvedVehicle, recording_of, scene_recording_of
from tests.viz.made_up import Example, record


@dataclass(frozen=True)
class Layout:
    """How often each view is there, what the zoomed ones show, and what each view is of."""

    views: Counter[str]
    bounds: list
    eyes: list
    contents: list


def layout_of(path: Path) -> Layout:
    from rerun.chunk import RrdReader

    reader = RrdReader(path)
    assert len(reader.recordings()) == 1
    (store,) = reader.blueprints()
    batches = [chunk.to_record_batch() for chunk in reader.stream(store=store)]

    def values(component: str) -> list:
        found = [row for b in batches if component in b.schema.names for row in b.column(component).to_pylist()]
        return sorted(found, key=str)

    names = Counter(name for (name,) in values("ViewBlueprint:display_name"))
    queries = [" ".join(query) for query in values("ViewContents:query")]
    return Layout(names, values("VisualBounds2D:range"), values("EyeControls3D:position"), queries)


def test_every_recording_has_all_views_zoomed_to_its_own_vehicle(example: Example, tmp_path: Path) -> None:
    def layout(name: str, box_shift: float) -> Layout:
        observation = replace(example.observation, box=example.observation.box + box_shift)
        return layout_of(record(tmp_path / name, example.reconstruction, observation, example.camera))

    here, there = layout("here.rrd", 0.0), layout("there.rrd", 300.0)
    assert here == layout("again.rrd", 0.0)
    assert {"Weights", "Shape", "Log", "Result", "Scene: camera frame, metres"} < set(here.views)
    assert set(here.views.values()) == {1}
    assert len(here.bounds) == 2  # of the image and of the factor graph
    assert sum(bound in there.bounds for bound in here.bounds) == 1
    assert len(here.eyes) == 1


def test_layouts_are_of_public_classes_of_rerun(example: Example) -> None:
    """So that another release makes of them what it wants; one needs no hook of this one."""
    import rerun.blueprint as rrb

    sight = SolvedVehicle(example.reconstruction, example.observation, example.camera, title="car")
    for recording in (
        recording_of(replace(sight, truth=example.truth)),
        scene_recording_of([sight]),
    ):
        assert type(recording.layout()) is rrb.Blueprint
