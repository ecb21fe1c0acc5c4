"""The table of `fgrecon reconstruct` where there are very many vehicles."""

from dataclasses import replace

import numpy as np
import pytest

from fgrecon.batch.solve_tasks import Outcome
from fgrecon.batch.vehicle_tasks import VehicleTask
from fgrecon.cli import reconstruct_report
from fgrecon.cli.terminal import Screen
from fgrecon.core.camera import Camera
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.keypoint_file import Instance

from .conftest import K


def refused(count):
    error = InvalidInputError("keypoints", "no measured point", "Give at least 3.")
    nothing = np.full((14, 2), np.nan)
    return [Outcome(VehicleTask(Instance(f"car-{number}", nothing), Camera(K)), None, error) for number in range(count)]


def screen(*, quiet=False):
    return Screen(error=False, quiet=quiet, verbose=False, progress=False)


@pytest.mark.parametrize("more", [0, 1, 700])
def test_the_first_are_shown_and_the_others_counted(capsys, more):
    reconstruct_report.print_table(screen(), refused(300 + more))
    lines = capsys.readouterr().out.splitlines()
    assert sum("refused" in line for line in lines[2:302]) == 300
    assert "car-6, car-7 and 292 more: keypoints: no measured point" in " ".join(lines)
    last = f"... and {more} more ({more} refused). The results file of --json or --out has all of them."
    assert (lines[-1] == last) == (more > 0)


def test_no_table_is_made_that_is_not_shown(capsys, monkeypatch):
    monkeypatch.setattr(reconstruct_report, "compact_table", None)
    reconstruct_report.print_table(screen(quiet=True), refused(3))
    assert capsys.readouterr() == ("", "")


def test_an_id_of_any_length_takes_one_row(capsys):
    (one,) = refused(1)
    instance = replace(one.task.instance, name="a\nb" + "x" * 100_000)
    reconstruct_report.print_table(screen(), [replace(one, task=replace(one.task, instance=instance))])
    row = capsys.readouterr().out.splitlines()[2]
    assert row.startswith("a bxxx")
    assert row.rstrip().endswith("refused")
    assert len(row) < 200
