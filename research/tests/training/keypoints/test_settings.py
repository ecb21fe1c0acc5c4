"""Settings files of trainings: what they say, what is refused, and that the shipped one is that of the networks."""

from pathlib import Path

import pytest

from fgrecon.core.errors import InvalidInputError

pytest.importorskip("torch")

from fgrecon.perception.keypoints.network_file import WITHOUT_STREET, shipped
from fgrecon_research.cli.training.keypoints import TrainingOptions
from fgrecon_research.training.keypoints.augment import Street
from fgrecon_research.training.keypoints.networks import Plan
from fgrecon_research.training.keypoints.settings import Phase, TrainingSettings, read_settings, shipped_settings
from fgrecon_research.training.keypoints.trainer import load_tensors

SHIPPED = "keypoints-car14"
ONE = '[[phase]]\nname = "one"\n'


def written(tmp_path, text):
    path = tmp_path / "settings.toml"
    path.write_text(text)
    return path


def test_a_file_says_what_the_plan_does_not(tmp_path):
    text = (
        'needs = ["marks"]\nmarks = "m.json"\nstart = "/s.safetensors"\nwithout = ["a"]\ndevice = "cuda"\nworkers = 2\n'
        f'{ONE}steps = 7\nrelabel_at = [2, 3]\nrate = 1\ndull = 0\nraised = 0.1\ntrained = "t.safetensors"\n'
        '[[phase]]\nname = "two"\nsilhouettes = false\ndrives = ["b/a"]\nstart_share = 0\n'
    )
    found = read_settings(written(tmp_path, text))
    assert found == TrainingSettings(
        (
            Phase(
                "one",
                Plan(steps=7, relabel_at=(2, 3), rate=1.0, dull=0.0, raised=0.1),
                trained=tmp_path / "t.safetensors",
            ),
            Phase("two", drives=("b/a",), silhouettes=False, start_share=0.0),
        ),
        needs=("marks",),
        marks=tmp_path / "m.json",
        start=Path("/s.safetensors"),
        without=("a",),
        device="cuda",
        workers=2,
    )
    assert [phase.on_street for phase in found.phases] == [False, True]


def test_options_take_the_place_of_what_the_file_says(tmp_path):
    found = read_settings(
        written(tmp_path, f'device = "cuda"\n{ONE}steps = 7\nseed = 1\n[[phase]]\nname = "two"\ndrives = ["a"]\n')
    )
    changed = TrainingOptions(device="cpu", without="a, b", trained=["two=t"]).applied(found)
    assert (changed.device, changed.without) == ("cpu", ("a", "b"))
    assert [phase.trained for phase in changed.phases] == [None, Path("t")]
    assert TrainingOptions().applied(found) == found
    assert found.with_trained({"two": Path("t")}).phases[1].trained == Path("t")


@pytest.mark.parametrize(
    ("text", "field", "value", "fix"),
    [
        ("", "phase", "nothing", "[[phase]]"),
        ("phase = 3", "phase", 3, "[[phase]]"),
        ("steps = 3\n" + ONE, "steps", 3, "imagenet"),
        ("workers = -1\n" + ONE, "workers", -1, "whole number"),
        ("device = 1\n" + ONE, "device", 1, "text"),
        ("marks = true\n" + ONE, "marks", True, "text"),
        ('without = "a"\n' + ONE, "without", "a", "list"),
        ("without = [1]\n" + ONE, "without[0]", 1, "text"),
        ('needs = ["steps"]\n' + ONE, "needs", "steps", "imagenet"),
        ("[[phase]]\nsteps = 3", "phase 1: name", "nothing", "Give"),
        ('[[phase]]\nname = "a/b"', "phase a/b: name", "a/b", "letters"),
        (ONE + ONE, "phase", "one", "a name of its own"),
        (ONE + "step = 3", "phase one: step", 3, "refine_steps"),
        (ONE + 'steps = "3"', "phase one: steps", "3", "whole number"),
        (ONE + "steps = 1.5", "phase one: steps", 1.5, "whole number"),
        (ONE + "steps = true", "phase one: steps", True, "whole number"),
        (ONE + "decay = 2.0", "phase one: decay", 2.0, "from 0 to 1"),
        (ONE + "dull = 2", "phase one: dull", 2, "from 0 to 1"),
        (ONE + "start_share = -1", "phase one: start_share", -1, "from 0 to 1"),
        (ONE + "relabel_at = [3, 2]", "phase one: relabel_at", [3, 2], "rising"),
        (ONE + "relabel_at = 3", "phase one: relabel_at", 3, "rising"),
        (ONE + "marks = 1", "phase one: marks", 1, "True or False"),
        (ONE + 'street = "s.json"\ndrives = ["a"]', "phase one: drives", "a", "either"),
    ],
)
def test_errors_name_key_value_and_fix(tmp_path, text, field, value, fix):
    path = written(tmp_path, text)
    with pytest.raises(InvalidInputError) as caught:
        read_settings(path)
    assert caught.value.field == f"{path}: {field}"
    assert caught.value.value == value
    assert fix in caught.value.fix


@pytest.mark.parametrize(("name", "text"), [("none.toml", None), ("keypoints-car15", None), ("settings.toml", "= 3")])
def test_files_that_cannot_be_read(tmp_path, name, text):
    path = tmp_path / name
    if text is not None:
        path.write_text(text)
    with pytest.raises(InvalidInputError, match=SHIPPED if text is None else "TOML"):
        read_settings(path)


def test_the_shipped_settings_are_how_the_shipped_networks_were_made():
    """Oracle: what the networks' files say of their last trainings and of the shares."""
    assert shipped_settings() == (SHIPPED,)
    found = read_settings(SHIPPED)
    assert found.marks.is_file()
    assert found.needs == ("imagenet", "silhouettes")
    assert [phase.on_street for phase in found.phases] == [False] * 7 + [True]
    for phase, network in ((found.phases[-1], None), (found.phases[-2], WITHOUT_STREET)):
        provenance, plan = load_tensors(shipped(network)).provenance, phase.plan
        stops = [stop for stop in plan.relabel_at if stop < plan.steps]
        words = f"{plan.steps} steps of {plan.batch}, labels corrected at {stops}, seed {plan.seed}"
        assert provenance["training"] == words
        shares = [part.split(" is left")[0] for part in provenance["start"].split("of which ")[1:]]
        before = found.phases[1 : found.phases.index(phase) + 1]
        assert shares == [f"{each.start_share:g}" for each in reversed(before)]
    street = found.phases[-1]
    assert f"street cars in {street.street_share:g} of the samples" in load_tensors(shipped()).provenance["data"]
    assert len(street.drives) == 8


@pytest.mark.data
def test_the_shipped_settings_name_drives_that_are_there(data):
    drives = [data / drive for drive in read_settings(SHIPPED).phases[-1].drives]
    assert all((drive / "label_02.txt").is_file() for drive in drives)
    assert {path.name for path in (data / "kitti_video").iterdir() if path.is_dir()} < {drive.name for drive in drives}


def test_a_plan_says_what_samples_are_like():
    street = Plan(dull=0.25, raised=0.0, seen_alone=0.75).samples_of(Street(covered=0.1))
    assert (street.dull, street.raised, street.seen_alone, street.covered) == (0.25, 0.0, 0.75, 0.1)
    assert Plan().samples_of(Street()) == Street()
    shares = {(p.plan.dull, p.plan.raised, p.plan.seen_alone) for p in read_settings(SHIPPED).phases}
    assert shares == {(0.0, 0.0, 0.0)}  # there were none when the shipped networks were trained
