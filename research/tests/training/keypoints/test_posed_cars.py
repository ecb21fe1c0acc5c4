"""Reading posed photographs."""

import json

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.perception.keypoints.layout import KINDS
from fgrecon_research.training.keypoints.deform import UNKNOWN_KIND
from fgrecon_research.training.keypoints.posed_cars import groups, read_posed_cars, read_validation_ids

ENTRY = {
    "image": "1.jpg",
    "width": 20,
    "height": 10,
    "cad_id": "b",
    "K": [[100, 0, 10], [0, 100, 5], [0, 0, 1]],
    "R": [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
    "t": [0, 0, 2],
}


def written(folder, entries):
    (folder / "annotations.json").write_text(json.dumps(entries))
    return folder


def test_fields_and_directions(tmp_path):
    (car,) = read_posed_cars(written(tmp_path, [ENTRY]))
    assert car.image == tmp_path / "images" / "1.jpg"
    np.testing.assert_allclose(car.box, [-0.5, -0.5, 19.5, 9.5])
    # The car's forward axis points along -z of the camera, so it is seen from ahead.
    assert car.azimuth == pytest.approx(0.0)
    np.testing.assert_allclose(car.project(np.zeros(3)), [10, 5])
    assert car.name == ""
    (named,) = read_posed_cars(written(tmp_path, [{**ENTRY, "model_name": "Audi TTS Coupe 2012"}]))
    assert named.name == "Audi TTS Coupe 2012"


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("Audi TTS Coupe 2012", "car"),
        ("GMC Savana Van 2012", "van"),
        ("Dodge Sprinter Cargo Van 2009", "van"),
        ("Honda Odyssey Minivan 2012", None),
        ("Ram C/V Cargo Van Minivan 2012", None),
        ("Ford Ranger SuperCab 2011", None),
        ("", None),
    ],
)
def test_kinds_by_the_name_of_the_model(name, kind, tmp_path):
    (car,) = read_posed_cars(written(tmp_path, [{**ENTRY, "model_name": name}]))
    assert car.kind == (UNKNOWN_KIND if kind is None else KINDS.index(kind))


def test_a_dolly_zoom_keeps_direction_and_size(tmp_path):
    (car,) = read_posed_cars(written(tmp_path, [{**ENTRY, "t": [0.2, -0.1, 2]}]))
    far = car.zoomed(3.0)
    np.testing.assert_allclose(far.project(np.zeros(3)), car.project(np.zeros(3)), atol=1e-9)
    np.testing.assert_allclose(far.translation, 3.0 * car.translation)
    assert far.azimuth == pytest.approx(car.azimuth)
    across = np.array([[0.0, 0.0, 0.1], [0.0, 0.1, 0.0]])  # at the car's own depth, where nothing changes
    np.testing.assert_allclose(far.project(across), car.project(across), atol=1e-9)
    np.testing.assert_allclose(far.zoomed(1 / 3.0).matrix, car.matrix, atol=1e-9)


def test_groups_are_ordered(tmp_path):
    cars = read_posed_cars(written(tmp_path, [ENTRY, {**ENTRY, "cad_id": "a"}, ENTRY]))
    assert groups(cars) == {"a": [1], "b": [0, 2]}


def test_models_of_cars_that_share_a_3d_model_are_shapes_of_their_own(tmp_path):
    names = ("Honda Accord Sedan 2012", "Honda Accord Coupe 2012")
    cars = read_posed_cars(written(tmp_path, [{**ENTRY, "model_name": name} for name in names]))
    assert groups(cars) == {"b Honda Accord Coupe 2012": [1], "b Honda Accord Sedan 2012": [0]}


def test_what_is_wrong_is_named(tmp_path):
    with pytest.raises(InvalidInputError, match=r"\[1\].cad_id"):
        read_posed_cars(written(tmp_path, [ENTRY, {k: v for k, v in ENTRY.items() if k != "cad_id"}]))
    with pytest.raises(InvalidInputError, match="list of photographs"):
        read_posed_cars(written(tmp_path, {}))
    (tmp_path / "ids.json").write_text("[1]")
    with pytest.raises(InvalidInputError, match="list of names"):
        read_validation_ids(tmp_path / "ids.json")
