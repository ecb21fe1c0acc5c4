"""`fgrecon keypoints train --settings`: two phases of small networks on made-up photographs and drives."""

import json

import pytest
from typer.testing import CliRunner

from fgrecon.cli.main import app
from fgrecon.core.errors import InvalidInputError
from fgrecon.io import files
from fgrecon.io.catalogue import load_prior
from fgrecon_research.training.keypoints.trainer import load_tensors
from research.tests.annotation.streets import Car, GivenKeypoints, write_drive
from research.tests.training.keypoints.support import make_small
from research.tests.training.keypoints.test_rounds import source  # noqa: F401 - a fixture

pytest.importorskip("torch")

from fgrecon_research.cli.training import label
from fgrecon_research.training.keypoints import rounds

PRIOR = load_prior("car14")
FRAMES = [{1: Car((0.0, 1.65, 15.0), 0.4)}]
SETTINGS = """
workers = 0

[[phase]]
name = "alone"
steps = 2
batch = 2
relabel_at = [1]
refine_steps = 1

[[phase]]
name = "street"
drives = ["near", "far"]
start_share = 0.25
street_share = 0.75
steps = 2
batch = 2
relabel_at = []
refine_steps = 1
rate = 1e-4
seed = 3
"""


class Killed(BaseException):
    """As from outside: nothing catches it."""


class Network(GivenKeypoints):
    """Knows the cars of both drives."""

    provenance = {"data": "made up"}  # noqa: RUF012 - what a network has

    def __init__(self, weights):
        assert load_tensors(weights).refinement is not None
        super().__init__(FRAMES, PRIOR)


@pytest.fixture(scope="module")
def place(source, tmp_path_factory):  # noqa: F811
    """A folder with settings and data; the trainings are small."""
    folder = tmp_path_factory.mktemp("place")
    (folder / "settings.toml").write_text(SETTINGS)
    for name in ("near", "far"):
        write_drive(folder / "data" / name, PRIOR, FRAMES)
    with pytest.MonkeyPatch.context() as patch:
        make_small(source, patch)
        patch.setattr(label, "KeypointCascade", Network)
        # A network that knows nothing would correct the photographs' labels to where no shape is.
        patch.setattr(rounds, "corrected", lambda _, first, *more: first)
        yield folder


def run(place, work, out, *more, settings="settings.toml"):
    arguments = ["--settings", place / settings, "--data", place / "data", "--work", place / work, "--out", place / out]
    return CliRunner().invoke(app, ["keypoints", "train", *(str(argument) for argument in (*arguments, *more))])


@pytest.fixture(scope="module")
def unbroken(place):
    """The whole at one go: the file's stem, and what was shown."""
    (place / "work").mkdir()
    done = run(place, "work", "whole.safetensors")
    assert done.exit_code == 0, done.output
    return done


def contents(place, stem):
    return [(place / f"{stem}{end}.safetensors").read_bytes() for end in ("", "-photographs")]


def test_one_command_makes_both_networks(place, unbroken):
    assert unbroken.stdout == "".join(f"Wrote {place / f'whole{end}.safetensors'}.\n" for end in ("", "-photographs"))
    lines = unbroken.stderr.splitlines()
    for line in ("alone: Training to step 2", "street: Labels of street cars", "street: Calibration"):
        assert line in lines
    assert [line for line in lines if line.endswith("Labels from the boxes")] == ["alone: Labels from the boxes"]
    whole, alone = (load_tensors(place / f"whole{end}.safetensors") for end in ("", "-photographs"))
    assert "street cars" in whole.provenance["data"]
    assert "street cars" not in alone.provenance["data"]
    assert whole.provenance["start"].startswith("alone.safetensors (of which 0.25 is left in the weights)")
    first, second = json.loads(whole.provenance["settings"])
    assert [first] == json.loads(alone.provenance["settings"])
    assert (first["name"], first["steps"], first["relabel_at"], first["rate"]) == ("alone", 2, [1], 1e-3)
    assert (second["drives"], second["street_share"], second["seed"]) == (["near", "far"], 0.75, 3)


def test_quiet(place, unbroken):
    assert run(place, "work", "whole.safetensors", "-q").output == ""


def test_a_run_that_was_killed_ends_like_an_unbroken_one(place, unbroken, monkeypatch):
    replacing, left = files.replacing, 0

    def killing(path):
        nonlocal left
        left -= 1
        if left < 0:
            raise Killed
        return replacing(path)

    kills = 0
    with monkeypatch.context() as patch:
        patch.setattr(files, "replacing", killing)
        (place / "again").mkdir()
        while True:
            left = 5  # files that are written before the next one finds the run killed
            try:
                done = run(place, "again", "again.safetensors")
            except Killed:
                kills += 1
                assert kills < 20
                continue
            break
    assert done.exit_code == 0, done.output
    assert kills > 3
    assert contents(place, "again") == contents(place, "whole")


def test_finished_phases_are_taken_over(place, unbroken):
    done = run(place, "work", "twice.safetensors")
    assert done.exit_code == 0, done.output
    assert done.stderr.splitlines() == ["alone: finished before", "street: finished before"]
    assert contents(place, "twice") == contents(place, "whole")


def test_a_damaged_network_is_made_again(place, unbroken):
    file = place / "work" / "street" / "street.safetensors"
    file.write_bytes(b"half")
    done = run(place, "work", "mended.safetensors")
    assert done.exit_code == 0, done.output
    assert "alone: finished before" in done.stderr
    assert "street: finished before" not in done.stderr
    assert contents(place, "mended") == contents(place, "whole")


def test_folds_share_what_has_seen_no_street(place, unbroken):
    done = run(place, "work", "fold.safetensors", "--without", "far")
    assert done.exit_code == 0, done.output
    assert "alone: finished before" in done.stderr
    assert "street: Labels of street cars" not in done.stderr  # those of all drives are there
    assert "street: Labels corrected" not in done.stderr  # nor are the photographs' made again
    (common,) = (place / "work").glob("_photographs-*")
    assert [path.parent for path in (place / "work").rglob("images.npy") if path.parent.name != "street"] == [
        common / "photographs"
    ]
    assert (place / "work" / "street" / "without-far" / "phase.json").exists()
    fold, whole = contents(place, "fold"), contents(place, "whole")
    assert fold[1] == whole[1]
    assert fold[0] != whole[0]
    provenance = load_tensors(place / "fold.safetensors").provenance
    assert provenance["data"].endswith("; 1 street cars in 0.75 of the samples, without far")
    assert json.loads(provenance["settings"])[1]["without"] == ["far"]


def test_a_network_takes_the_place_of_a_phase(place, unbroken):
    alone = place / "whole-photographs.safetensors"
    done = run(place, "apart", "apart.safetensors", "--trained", f"alone={alone}")
    assert done.exit_code == 0, done.output
    assert not (place / "apart" / "alone").exists()
    assert contents(place, "apart")[1] == alone.read_bytes()
    first, second = json.loads(load_tensors(place / "apart.safetensors").provenance["settings"])
    assert (first["trained"], second["name"]) == (alone.name, "street")


def test_a_phase_that_was_run_otherwise_is_refused(place, unbroken):
    for line, changed in (("steps = 3", "steps: 2 became 3."), ("steps = 2\nseed = 5", "seed: 0 became 5.")):
        (place / "other.toml").write_text(SETTINGS.replace("steps = 2", line, 1))
        done = run(place, "work", "other.safetensors", settings="other.toml")
        assert isinstance(done.exception, InvalidInputError)
        assert done.exception.field == "phase alone"
        assert changed in done.exception.fix
        assert str(place / "work" / "alone") in done.exception.fix
    calib = place / "data" / "near" / "calib.txt"
    before = calib.read_text()
    calib.write_text(before.replace("700", "701"))
    done = run(place, "work", "other.safetensors")
    calib.write_text(before)
    assert isinstance(done.exception, InvalidInputError)
    assert done.exception.field == "phase street"
    assert "street: " in done.exception.fix
    assert not (place / "other.safetensors").exists()


def test_street_cars_of_a_file_take_the_place_of_drives(place, unbroken):
    (labels,) = (place / "work" / "street").glob("street-*.json")
    alone = place / "whole-photographs.safetensors"
    (place / "filed.toml").write_text(SETTINGS.replace('drives = ["near", "far"]', f'street = "{labels}"'))
    done = run(place, "filed", "filed.safetensors", "--trained", f"alone={alone}", settings="filed.toml")
    assert done.exit_code == 0, done.output
    assert "Labels of street cars" not in done.stderr
    second = json.loads(load_tensors(place / "filed.safetensors").provenance["settings"])[1]
    assert second["street"] == labels.name


@pytest.mark.parametrize(
    ("more", "changed", "field", "named"),
    [
        (("--without", "far,farther"), {}, "without", "far, near"),
        (("--trained", "lone=x"), {}, "trained", "alone, street"),
        (("--trained", "alone"), {}, "trained", "PHASE=FILE"),
        (("--trained", "alone=nowhere"), {}, "weights", "train"),
        ((), {'"far"]': '"nowhere"]'}, "phase street: drives", "exists"),
        ((), {"workers = 0": 'needs = ["imagenet"]'}, "imagenet", "--imagenet"),
        (("--silhouettes", "nowhere"), {}, "silhouettes", "folder"),
        ((), {"workers = 0": 'start = "nowhere"'}, "start", "file"),
        ((), {'drives = ["near", "far"]': 'street = "nowhere.json"'}, "phase street: street", "file"),
        ((), {'name = "alone"': 'name = "alone"\ndrives = ["near"]'}, "phase alone: drives", "street"),
    ],
)
def test_what_cannot_be_run_is_refused_before_the_work(place, more, changed, field, named):
    text = SETTINGS
    for old, new in changed.items():
        assert old in text
        text = text.replace(old, new)
    (place / "wrong.toml").write_text(text)
    done = run(place, "nothing", "nothing.safetensors", *more, settings="wrong.toml")
    assert isinstance(done.exception, InvalidInputError), done.output
    assert done.exception.field == field
    assert named in done.exception.fix
    assert not (place / "nothing").exists()


def test_nobody_knows_which_drives_a_given_network_has_seen(place, unbroken):
    trained = f"street={place / 'whole.safetensors'}"
    done = run(place, "given", "given.safetensors", "--trained", trained, "--without", "far")
    assert isinstance(done.exception, InvalidInputError)
    assert done.exception.field == "phase street: trained"
    later = SETTINGS + '\n[[phase]]\nname = "later"\nsteps = 1\nrelabel_at = []\nrefine_steps = 0\n'
    (place / "later.toml").write_text(later)
    given = ("--trained", f"later={place / 'whole.safetensors'}", "--without", "far")
    done = run(place, "given", "given.safetensors", *given, settings="later.toml")
    assert isinstance(done.exception, InvalidInputError)
    assert done.exception.field == "phase later: trained"
    done = run(place, "given", "given.safetensors", "--trained", trained)
    assert done.exit_code == 0, done.output
    assert (place / "given.safetensors").read_bytes() == contents(place, "whole")[0]
    assert not (place / "given-photographs.safetensors").exists()


def test_drives_of_which_no_car_can_be_labelled_are_refused(place, unbroken, tmp_path):
    drive = write_drive(tmp_path / "empty", PRIOR, [{1: Car((0.0, 1.65, 90.0), 0.4)}])
    out = tmp_path / "labels.json"
    with pytest.raises(InvalidInputError, match=r"drives.*empty"):
        label.label_street([drive], place / "whole.safetensors", out, lambda things, heading: things)
    assert not out.exists()
