"""`benchmarks.bench_tracking`: the files that TrackEval gets; TrackEval itself has an environment of its own."""

from pathlib import Path

import pytest

from benchmarks.bench_tracking import followed, labels, prepare, table
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.kitti_files import read_drive
from research.tests.evaluation.test_video_images import folder  # noqa: F401  # a fixture

RESULT = "0 {id} Car -1 -1 0.1 300.0 120.0 440.0 270.0 1.5 1.6 4.0 1.0 1.6 15.0 0.2 0.9\n"


def test_labels_results_and_areas_to_ignore(folder, tmp_path):  # noqa: F811
    drive = read_drive(folder)
    (found,) = labels(drive).values()
    kinds = dict(zip(found.objects.kind, found.tracks.tolist(), strict=True))
    assert (kinds["Van"], kinds["DontCare"]) == (1, -1)
    assert found.objects.kind.count("DontCare") == (~drive.frames[0].usable).sum()
    run = tmp_path / "run"
    (run / "drive").mkdir(parents=True)
    path = run / "drive" / "tracks.txt"
    path.write_text(RESULT.format(id=5) + "7" + RESULT.format(id=5)[1:])  # the second in a frame that has no image
    (only,) = followed(drive, path).values()
    assert only.tracks.tolist() == [5]
    prepare([drive], {"mine": run}, tmp_path / "made")
    files = {str(p.relative_to(tmp_path / "made")): p.read_text() for p in Path(tmp_path / "made").rglob("*.*")}
    assert files["labels/evaluate_tracking.seqmap.training"] == "drive empty 000000 000001\n"
    assert len(files["labels/label_02/drive.txt"].splitlines()) == 8
    assert files["runs/mine/data/drive.txt"].startswith("0 5 Car")
    with pytest.raises(InvalidInputError, match=r"tracks\.txt"):
        prepare([drive], {"none": tmp_path}, tmp_path / "more")


def test_a_table_has_a_row_for_each_run_and_drive():
    numbers = {"HOTA": 58.44, "DetA": 54.0, "AssA": 63.0, "MOTA": 64.0, "IDSW": 38.0, "IDF1": 76.0}
    lines = table({"mine": {"drive": numbers, "COMBINED_SEQ": numbers}})
    assert lines[2:] == [
        "| mine | drive | 58.4 | 54.0 | 63.0 | 64.0 | 38 | 76.0 |",
        "| mine | all | 58.4 | 54.0 | 63.0 | 64.0 | 38 | 76.0 |",
    ]
