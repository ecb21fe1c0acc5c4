"""Categories and priors by name and from files: round trips, and errors that name file, field and fix."""

import json
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.shape_prior import ShapePrior, Surface
from fgrecon.io.catalogue import load_category, load_prior, save_prior, shipped_categories, shipped_priors

FIELDS = ("mean", "basis", "offset_sigma", "explained")
MEAN = np.array([[2.0, -0.3, 0.8], [2.0, -0.3, -0.8], [-2.0, -0.3, 0.8], [-2.0, -1.5, -0.8], [0.0, -1.5, 0.0]])


@pytest.fixture(scope="module")
def small_category():
    names = ["front_left", "front_right", "back_left", "back_top", "top"]
    return {
        "name": "small",
        "keypoints": names,
        "symmetric_pairs": [],
        "faces": [],
        "edges": [["front_left", "front_right"]],
        "dimensions": {
            "length": {"plus": names[:1], "minus": names[2:3], "ratio": 1.0},
            "width": {"plus": names[:1], "minus": names[1:2], "ratio": 1.0},
            "height": {"plus": names[3:4], "minus": names[:1], "ratio": 1.0},
        },
        "ground": {"keypoints": names[:3], "ratio": 0.2},
    }


def small_prior(category, **changes):
    fields = {"mean": MEAN, "basis": np.ones((2, 5, 3)), "offset_sigma": np.full(5, 0.1), "explained": [0.5, 0.2]}
    return ShapePrior(category, **{**fields, **changes})


@pytest.fixture
def category_file(small_category, tmp_path):
    file = tmp_path / "small.json"
    file.write_text(json.dumps(small_category))
    return file


def test_what_is_shipped():
    assert {"car14", "car36"} <= set(shipped_categories())
    assert {"car14", "apollo66", "apollo24", "pascal12"} == set(shipped_priors())
    for name in shipped_categories():
        category = load_category(name)
        assert category.name == name
        assert load_category(category) is category
        assert load_category(name) is category  # read once
        # Symmetric pairs are left and right of the same thing; every other description is symmetric as well.
        for left, right in category.symmetric_pairs:
            if name != "apollo66":  # there a part has a left and a right as well
                assert category.keypoints[left].replace("left", "right") == category.keypoints[right]
        edges = {frozenset(edge) for edge in category.edges}
        assert {frozenset(int(category.mirror[i]) for i in edge) for edge in edges} == edges
        assert all(set(category.mirror[list(face.keypoints)]) == set(face.keypoints) for face in category.faces)


@pytest.mark.parametrize("name", shipped_priors())
def test_shipped_priors_are_of_their_category_and_left_is_left(name):
    prior = load_prior(name)
    assert prior.category.to_dict() == load_category(name).to_dict()
    for left, right in prior.category.symmetric_pairs:
        assert prior.mean[left, 2] > 0 > prior.mean[right, 2]
    assert (prior.mean[:, 1] < 0).all()  # above the ground


def test_car36_keeps_the_names_of_points_that_car14_has_too():
    shared = set(load_category("car36").keypoints) & set(load_category("car14").keypoints)
    assert len(shared) == 8


def test_shipped_prior_is_shared_and_read_only():
    prior = load_prior("car14")
    assert load_prior("car14") is prior
    assert load_prior(prior) is prior
    with pytest.raises(ValueError, match="read-only"):
        prior.mean[0, 0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        prior.surface.basis[0, 0] = 1.0


def test_category_from_a_file(category_file, small_category):
    assert load_category(category_file).keypoints == tuple(small_category["keypoints"])
    assert load_category(str(category_file)) == load_category(category_file)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    basis=arrays(np.float64, (2, 5, 3), elements=st.floats(-1e6, 1e6)),
    vertices=arrays(np.float64, (4, 3), elements=st.floats(-10, 10, width=32)),
    name=st.text(st.characters(blacklist_categories=["Cs"], blacklist_characters="\0"), max_size=10),
)
def test_round_trip_keeps_every_bit(small_category, tmp_path_factory, basis, vertices, name):
    from fgrecon.core.category import Category

    surface = Surface(vertices, np.zeros((2, 4, 3)), np.array([[0, 1, 2]]))
    fields = {"surface": surface, "name": name, "provenance": {"source": name}, "mean_sigma": np.abs(basis[0])}
    prior = small_prior(Category.from_dict(small_category), basis=basis, **fields)
    file = tmp_path_factory.mktemp("prior") / "prior.npz"
    again = load_prior(save_prior(prior, file))
    for field in (*FIELDS, "mean_sigma"):
        assert np.array_equal(getattr(again, field), getattr(prior, field))
    assert np.array_equal(again.surface.mean, prior.surface.mean)
    assert np.array_equal(again.surface.faces, prior.surface.faces)
    assert (again.category, again.name, again.provenance) == (prior.category, prior.name, prior.provenance)
    first = file.read_bytes()
    save_prior(again, file)
    assert file.read_bytes() == first


def test_round_trip_without_surface_or_basis(small_category, category_file, tmp_path):
    prior = small_prior(load_category(category_file), basis=np.zeros((0, 5, 3)), explained=[])
    again = load_prior(save_prior(prior, tmp_path / "mean.npz"))
    assert (again.dimension, again.surface, again.mean_sigma) == (0, None, None)


@pytest.mark.parametrize("sigma", [np.zeros((4, 3)), np.full((5, 3), -0.1), np.full((5, 3), np.nan)])
def test_a_mean_that_is_wrongly_sure_is_refused(category_file, sigma):
    with pytest.raises(InvalidInputError, match="mean_sigma"):
        small_prior(load_category(category_file), mean_sigma=sigma)


def test_how_sure_a_mean_is_scales_with_it(category_file):
    prior = small_prior(load_category(category_file), mean_sigma=np.full((5, 3), 0.1)).scaled((2.0, 1.0, 3.0))
    np.testing.assert_allclose(prior.mean_sigma, np.tile([0.2, 0.1, 0.3], (5, 1)))


class TestErrors:
    """Each message names the file, the field and what to do."""

    @pytest.fixture
    def file(self, tmp_path):
        return save_prior(load_prior("car14"), tmp_path / "prior.npz")

    @staticmethod
    def rewrite(file, drop=(), **changes):
        with np.load(file) as archive:
            content = {name: archive[name] for name in archive.files if name not in drop}
        np.savez(file, **{**content, **changes})

    @staticmethod
    def error(source, load=load_prior):
        with pytest.raises(InvalidInputError) as caught:
            load(source)
        assert caught.value.fix
        return f"{caught.value.field} | {caught.value.value}"

    def test_missing_file_lists_the_names(self, tmp_path):
        with pytest.raises(InvalidInputError, match=r"no-such-prior.*shipped names: .*car14"):
            load_prior("no-such-prior")
        with pytest.raises(InvalidInputError, match=r"nothing.json.*car14, car36"):
            load_category(tmp_path / "nothing.json")
        assert str(tmp_path) in self.error(tmp_path)

    @pytest.mark.parametrize("content", [b"", b"hello", b"PK\x05\x06" + b"\0" * 10])
    def test_not_an_npz(self, tmp_path, content):
        file = tmp_path / "prior.npz"
        file.write_bytes(content)
        assert "prior.npz" in self.error(file)

    def test_damaged(self, file):
        content = bytearray(file.read_bytes())
        content[2000] ^= 0xFF
        file.write_bytes(content)
        assert "prior.npz" in self.error(file)
        file.write_bytes(bytes(content[:-3000]))
        assert "prior.npz" in self.error(file)

    def test_pickled_content_is_not_run(self, file):
        class Trap:
            def __reduce__(self):
                return pytest.fail, ("unpickled",)

        self.rewrite(file, mean=np.array([Trap()], dtype=object))
        assert "prior.npz: mean | pickled content" in self.error(file)
        file.write_bytes(pickle.dumps(Trap()))
        assert "not an npz" in self.error(file)

    @pytest.mark.parametrize(
        ("changes", "said"),
        [
            ({"mean": np.zeros((13, 3))}, "prior.mean | shape (13, 3)"),
            ({"mean": np.full((14, 3), np.nan)}, "prior.mean[0, 0] | nan"),
            ({"mean": np.array("text")}, "prior.mean"),
            ({"basis": np.zeros((5, 14))}, "prior.basis | shape (5, 14)"),
            ({"explained": np.zeros(4)}, "prior.explained"),
            ({"offset_sigma": -np.ones(14)}, "prior.offset_sigma | -1"),
            ({"surface_faces": np.full((1, 3), 5000)}, "prior.surface.faces | 5000"),
            ({"surface_basis": np.zeros((4, 1475, 3))}, "prior.surface.basis"),
            ({"format": np.array("other/2")}, "format | other/2"),
            ({"format": np.zeros(3)}, "format | float64 (3,)"),
            ({"category": np.array("{")}, "category | no JSON"),
            ({"category": np.array("[]")}, "category | a JSON list"),
            ({"category": np.array('{"keypoints": 3}')}, "category.keypoints | 3"),
            ({"provenance": np.array("3")}, "provenance | a JSON int"),
        ],
    )
    def test_wrong_content(self, file, changes, said):
        self.rewrite(file, **changes)
        message = self.error(file)
        assert message.startswith(str(file))
        assert said in message

    @pytest.mark.parametrize("field", ["format", "category", "name", "provenance", *FIELDS, "surface_faces"])
    def test_missing_array(self, file, field):
        self.rewrite(file, drop=[field])
        assert self.error(file) == f"{file}: {field} | no such array"

    def test_category_file(self, category_file, small_category):
        category_file.write_text(json.dumps({**small_category, "edges": 3}))
        assert self.error(category_file, load_category) == f"{category_file}: category.edges | 3"
        category_file.write_bytes(b"\xff\xfe")
        assert "small.json" in self.error(category_file, load_category)

    def test_saving_elsewhere(self, tmp_path):
        with pytest.raises(InvalidInputError, match="npz"):
            save_prior(load_prior("car14"), tmp_path / "prior.json")
        with pytest.raises(InvalidInputError, match="folder"):
            save_prior(load_prior("car14"), tmp_path / "missing" / "prior.npz")
