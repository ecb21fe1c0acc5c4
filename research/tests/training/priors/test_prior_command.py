"""`fgrecon prior build` on the real models, and what it says about input that it cannot use."""

import pytest
from typer.testing import CliRunner

from fgrecon.cli.main import app
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.catalogue import load_prior


def run(*arguments):
    return CliRunner().invoke(app, ["prior", *map(str, arguments)])


@pytest.mark.data
def test_build_makes_the_shipped_prior(data, tmp_path):
    out = tmp_path / "car14.npz"
    result = run("build", "--out", out, "--data", data)
    assert result.exit_code == 0, result.output
    assert "54.2, 29.7, 4.5, 2.9, 2.0 %, together 93.3 %" in result.stdout
    made, shipped = load_prior(out), load_prior("car14")
    assert made.basis == pytest.approx(shipped.basis, abs=1.5e-6)
    assert made.describe() == shipped.describe()


@pytest.mark.data
@pytest.mark.slow
def test_build_with_leave_one_out(data, tmp_path):
    result = run("build", "--out", tmp_path / "car14.npz", "--data", data, "--leave-one-out")
    assert result.exit_code == 0, result.output
    rows = [line.split() for line in result.stdout.splitlines()]
    assert ["5", "93.3", "6.1", "4.9", "5.4"] in rows


def test_errors(tmp_path):
    result = run("build", "--out", tmp_path / "car14.npz", "--data", tmp_path)
    assert isinstance(result.exception, InvalidInputError)
    assert "apollo79_car14" in str(result.exception)
