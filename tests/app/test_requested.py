"""What is requested of a service: read from queries, and said as a command and as Python that do the same."""

import shlex

import pytest

from fgrecon.app.requested import Requested
from fgrecon.app.solving import Uploaded
from fgrecon.app.written import as_code, as_command
from fgrecon.core.errors import InvalidInputError

ALL = [
    *(("intrinsics", "721.5,721.5,609.6,172.9"), ("distortion", "0.1,0,0,0"), ("ground", "0,1,0,1.65")),
    *(("size_prior", "kitti"), ("traffic", "right"), ("box", "1,2,30,40"), ("box", "5,6,70,80")),
    *(("box_model", "off"), ("min_confidence", "0.2"), ("strategy", "huber"), ("together", "no")),
]


def test_items_and_back():
    assert Requested.of(Requested.of(ALL).items) == Requested.of(ALL)


def test_settings_and_source():
    requested = Requested.of(ALL)
    settings, source = requested.settings(), requested.source()
    assert settings.ground.distance == 1.65
    assert settings.size_prior.name == "kitti"
    assert settings.options.box.model == "off"
    assert settings.options.keypoints.least_confidence == 0.2
    assert source.distortion == [0.1, 0, 0, 0]
    assert requested.boxes() == [[1, 2, 30, 40], [5, 6, 70, 80]]


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("priors", "car14"),
        ("prior", "/etc/passwd"),
        ("names", "../names.json"),
        ("strategy", "guess"),
        ("together", "maybe"),
    ],
)
def test_what_names_nothing_is_refused_at_once(name, text):
    with pytest.raises(InvalidInputError, match="Give one of"):
        Requested.of([(name, text)])


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("intrinsics", "1,2"),
        ("camera_height", "nan"),
        ("camera_height", "-1"),
        ("size_prior", "/etc/passwd"),
        ("ground", "a"),
        ("min_confidence", "2"),
        ("box", "1,2,3"),
        ("min_score", "x"),
    ],
)
def test_bad_values_name_their_field(name, text):
    requested = Requested.of([(name, text)])
    with pytest.raises(InvalidInputError) as refused:
        requested.settings(), requested.source(), requested.boxes(), requested.number("min_score")
    assert refused.value.field == name


def test_an_entry_is_given_once():
    with pytest.raises(InvalidInputError, match="once"):
        Requested.of([("ground", "1.6"), ("ground", "1.7")])


def test_the_command_is_one(tmp_path):
    from typer.testing import CliRunner

    from fgrecon.cli import main
    from fgrecon.cli.sample import sample_command  # noqa: F401

    words = shlex.split(as_command(Requested.of([i for i in ALL if i[0] != "distortion"]), Uploaded("none.png")))
    assert words[:3] == ["fgrecon", "reconstruct", "none.png"]
    done = CliRunner().invoke(main.app, words[1:])
    assert "none.png" in str(done.exception)  # all options were understood
    assert "--apart" in words


def test_the_code_of_keypoints_gives_what_the_command_gives(tmp_path, monkeypatch, capsys):
    from tests.docs.test_schemas import EXAMPLE

    monkeypatch.chdir(tmp_path)
    (tmp_path / "cars.json").write_text(EXAMPLE, encoding="utf-8")
    requested = Requested.of([("size_prior", "kitti"), ("camera_height", "1.65"), ("min_confidence", "0.1")])
    exec(as_code(requested, Uploaded("cars.json")), {})
    assert "Reconstruction: converged" in capsys.readouterr().out


def test_the_code_of_a_photograph_compiles():
    code = as_code(Requested.of(ALL), Uploaded("street.png"))
    compile(code, "code", "exec")
    assert "boxes=[(1,2,30,40), (5,6,70,80)]" in code
    assert "fgrecon.Camera.of((721.5,721.5,609.6,172.9), [0.1,0,0,0])" in code


def test_a_number_without_a_largest_one_is_told_as_such():
    with pytest.raises(InvalidInputError, match=r"camera_height: got -1\. Give a finite number of at least 0\."):
        Requested(camera_height="-1").settings()
