"""The shape prior as data, and the shipped default prior of cars."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.shape_prior import ShapePrior, Surface
from fgrecon.core.size_prior import SIZE_PRIORS
from fgrecon.io.catalogue import load_prior, save_prior
from fgrecon.solve.vehicle.conditioning import express
from fgrecon_research.io.kitti_sets import read_image_set, read_labels
from fgrecon_research.training.priors.apollo79 import DUPLICATE, apollo79_prior, leave_one_out, load_apollo79, rounded

FLIP = np.array([1.0, 1.0, -1.0])
PRIOR = load_prior("car14")
LAMBDA = arrays(np.float64, 5, elements=st.floats(-4, 4))


class TestShipped:
    def test_is_a_car(self):
        keypoints = dict(zip(PRIOR.category.keypoints, PRIOR.mean, strict=True))
        assert PRIOR.box_size(np.zeros(5)) == pytest.approx(SIZE_PRIORS["apollo79"].mean, abs=0.01)
        assert keypoints["left_front_wheel"] == pytest.approx([1.40, -0.34, 0.89], abs=0.02)
        assert keypoints["left_headlight"][0] > 1.9 > -1.9 > keypoints["left_taillight"][0]
        assert PRIOR.category.ground_ratio * 1.59 == pytest.approx(-keypoints["left_back_wheel"][1], abs=0.01)

    def test_explains_what_its_card_says(self):
        assert PRIOR.explained * 100 == pytest.approx([54.2, 29.7, 4.5, 2.9, 2.0], abs=0.05)
        assert PRIOR.offset_sigma.min() > 0.026
        assert PRIOR.offset_sigma.max() < 0.042

    @settings(max_examples=50, deadline=None, derandomize=True)
    @given(LAMBDA)
    def test_keypoints_are_symmetric_for_every_lambda(self, coefficients):
        assert PRIOR.is_symmetric
        mirror = PRIOR.category.mirror
        assert np.array_equal(PRIOR.mean, PRIOR.mean[mirror] * FLIP)
        assert np.array_equal(PRIOR.basis, PRIOR.basis[:, mirror] * FLIP)
        keypoints = PRIOR.keypoints(coefficients)
        assert np.abs(keypoints - keypoints[mirror] * FLIP).max() < 1e-14

    def test_surface_is_symmetric_for_every_lambda(self):
        """The mirror map is found in the mean; it then holds for the basis, hence for every lambda."""
        surface = PRIOR.surface
        index = {tuple(v): i for i, v in enumerate((surface.mean + 0.0).tolist())}
        mirror = np.array([index[tuple(v)] for v in (surface.mean * FLIP + 0.0).tolist()])
        assert np.array_equal(surface.basis, surface.basis[:, mirror] * FLIP)
        faces = {tuple(sorted(f)) for f in surface.faces.tolist()}
        assert {tuple(sorted(mirror[list(f)].tolist())) for f in faces} == faces

    def test_surface_is_closed_and_holds_the_keypoints(self):
        faces = PRIOR.surface.faces
        edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
        assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()
        for coefficients in (np.zeros(5), *np.eye(5) * 2, *np.eye(5) * -2):
            corners = PRIOR.surface.vertices(coefficients)[faces]
            volume = np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
            assert 4.0 < volume < 12.0  # positive: triangles are turned outward
            # Points spread over every triangle lie within 10 cm of every keypoint.
            spread = np.random.default_rng(0).dirichlet(np.ones(3), size=20)
            points = np.einsum("ka,fac->fkc", spread, corners).reshape(-1, 3)
            gaps = np.linalg.norm(points[None] - PRIOR.keypoints(coefficients)[:, None], axis=2).min(axis=1)
            assert gaps.max() < 0.1


class TestShapePrior:
    @settings(max_examples=30, deadline=None, derandomize=True)
    @given(LAMBDA, arrays(np.float64, (14, 3), elements=st.floats(-0.1, 0.1)))
    def test_linear(self, coefficients, offsets):
        expected = PRIOR.mean + sum(c * b for c, b in zip(coefficients, PRIOR.basis, strict=True)) + offsets
        assert PRIOR.keypoints(coefficients, offsets) == pytest.approx(expected, abs=1e-12)

    @settings(max_examples=30, deadline=None, derandomize=True)
    @given(LAMBDA, arrays(np.float64, 3, elements=st.floats(0.5, 2)))
    def test_scaling_scales_keypoints_surface_and_box(self, coefficients, factors):
        scaled = PRIOR.scaled(factors)
        assert scaled.keypoints(coefficients) == pytest.approx(PRIOR.keypoints(coefficients) * factors)
        vertices = PRIOR.surface.vertices(coefficients)
        assert scaled.surface.vertices(coefficients) == pytest.approx(vertices * factors)
        assert scaled.box_size(coefficients) == pytest.approx(PRIOR.box_size(coefficients) * factors[[0, 2, 1]])
        assert scaled.is_symmetric

    def test_for_fleet(self):
        kitti = SIZE_PRIORS["kitti"]
        prior = PRIOR.for_fleet(kitti)
        assert prior.box_size(np.zeros(5)) == pytest.approx(kitti.mean)
        assert "kitti" in prior.name
        assert "car14" in prior.name

    def test_truncated(self):
        prior = PRIOR.truncated(2)
        assert (prior.dimension, len(prior.explained), len(prior.surface.basis)) == (2, 2, 2)
        assert prior.keypoints([1.0, -1.0]) == pytest.approx(PRIOR.keypoints([1.0, -1.0, 0, 0, 0]))
        with pytest.raises(InvalidInputError, match="0 to 5"):
            PRIOR.truncated(6)

    @pytest.mark.parametrize(
        ("changes", "field"),
        [
            ({"mean": np.zeros((14, 2))}, "prior.mean"),
            ({"mean": np.outer(np.arange(14), [1.0, 2.0, 3.0])}, "prior.mean"),
            ({"mean": PRIOR.mean * [-1, 1, 1]}, "prior.mean"),
            ({"basis": PRIOR.basis[:, :13]}, "prior.basis"),
            ({"basis": np.where(PRIOR.basis > 0.1, np.inf, PRIOR.basis)}, "prior.basis"),
            ({"explained": np.zeros(3)}, "prior.explained"),
            ({"offset_sigma": np.full(14, -1.0)}, "prior.offset_sigma"),
            ({"mean": PRIOR.mean * 1e5}, "prior.mean"),
            ({"mean": PRIOR.mean * 0.1}, "prior.mean"),
            ({"surface": Surface(np.zeros((3, 3)), np.zeros((4, 3, 3)), np.zeros((1, 3), int))}, "prior.surface.basis"),
            ({"surface": "mesh"}, "prior.surface"),
        ],
    )
    def test_errors_name_the_field(self, changes, field):
        fields = {f: getattr(PRIOR, f) for f in ("category", "mean", "basis", "offset_sigma", "explained", "surface")}
        with pytest.raises(InvalidInputError) as error:
            ShapePrior(**{**fields, **changes})
        assert error.value.field.startswith(field)

    @pytest.mark.parametrize(
        ("mean", "basis", "faces", "field"),
        [
            (np.zeros((3, 3)), np.zeros((5, 4, 3)), np.zeros((1, 3), int), "prior.surface.basis"),
            (np.zeros((3, 3)), np.full((5, 3, 3), np.nan), np.zeros((1, 3), int), "prior.surface.basis"),
            (np.zeros((3, 3)), np.zeros((5, 3, 3)), np.full((1, 3), 3), "prior.surface.faces"),
            (np.zeros((3, 3)), np.zeros((5, 3, 3)), np.zeros((1, 3)), "prior.surface.faces"),
            (np.zeros((0, 3)), np.zeros((5, 0, 3)), np.zeros((0, 3), int), "prior.surface.mean"),
            (np.full((3, 3), 1e300), np.zeros((5, 3, 3)), np.zeros((1, 3), int), "prior.surface.mean"),
            ("abc", "abc", "abc", "prior.surface.mean"),
        ],
    )
    def test_a_surface_that_is_none_is_refused(self, mean, basis, faces, field):
        with pytest.raises(InvalidInputError) as error:
            Surface(mean, basis, faces)
        assert error.value.field.startswith(field)

    def test_a_prior_in_centimetres_is_refused(self):
        with pytest.raises(InvalidInputError, match=r"metres: length, width and height are 0\.3 to 30 m"):
            replace(PRIOR, surface=None).scaled(100.0)


@pytest.fixture(scope="module")
def models(data):
    return load_apollo79(data)


@pytest.mark.data
class TestApollo79:
    def test_models(self, models, data):
        assert models.keypoints.shape == (79, 14, 3)
        assert np.array_equal(models.keypoints, models.keypoints[:, PRIOR.category.mirror] * FLIP)
        assert (models.scale != 1).sum() == 4
        assert ((models.scale > 0.85) & (models.scale <= 1)).all()
        assert models.size[models.index(["baoma-330"])[0]] == pytest.approx([4.531, 1.814, 1.408], abs=1e-3)
        first, second = models.index(DUPLICATE)
        assert np.abs(models.keypoints[first] - models.keypoints[second]).max() < 0.021
        assert load_apollo79(data / "apollo79" / "apollo79_car14.npz").names == models.names

    def test_ratios_and_sizes_of_the_category_and_the_size_prior_are_the_measured_ones(self, models):
        kept = np.arange(79) != models.index(DUPLICATE[1:])[0]
        keypoints, size = models.keypoints[kept], models.size[kept]
        category = PRIOR.category
        boxes = np.tensordot(keypoints, category.dimension_operator, axes=([1, 2], [1, 2]))
        assert (boxes / size).mean(axis=0) == pytest.approx(np.ones(3), abs=1.5e-3)
        ground = -keypoints[:, list(category.ground_keypoints), 1].mean(axis=1) / size[:, 2]
        assert category.ground_ratio == pytest.approx(ground.mean(), abs=5e-4)
        fleet = SIZE_PRIORS["apollo79"]
        assert fleet.mean == pytest.approx(size.mean(axis=0), abs=0.005)
        assert fleet.sigma == pytest.approx(size.std(axis=0, ddof=1), abs=0.005)

    def test_shipped_prior_is_made_again_bit_for_bit(self, models, tmp_path):
        prior = rounded(apollo79_prior(models))
        first, second = (save_prior(prior, tmp_path / name) for name in ("a.npz", "b.npz"))
        assert first.read_bytes() == second.read_bytes()
        again = load_prior(first)
        for field in ("mean", "basis", "offset_sigma", "explained"):  # 1e-6 is what is rounded to
            assert getattr(again, field) == pytest.approx(getattr(PRIOR, field), abs=1.5e-6)
        assert again.surface.mean == pytest.approx(PRIOR.surface.mean, abs=1.5e-6)
        assert again.surface.basis == pytest.approx(PRIOR.surface.basis, abs=1.5e-6)
        assert np.array_equal(again.surface.faces, PRIOR.surface.faces)
        assert again.provenance == PRIOR.provenance

    def test_a_car_held_out_by_either_of_its_names_is_not_learnt_from(self, models):
        priors = [apollo79_prior(models, exclude=[name]) for name in DUPLICATE]
        assert np.array_equal(priors[0].mean, priors[1].mean)
        assert "77 of the 79" in priors[0].provenance["source"]
        with pytest.raises(InvalidInputError, match="no-such-car"):
            apollo79_prior(models, exclude=["no-such-car"])

    def test_a_model_counts_as_its_weight_says(self, models):
        weights = np.ones(len(models.names))
        weights[12] = 1e6
        prior = apollo79_prior(models, weights=weights)
        assert prior.mean == pytest.approx(models.keypoints[12], abs=1e-3)
        with pytest.raises(InvalidInputError, match="weights"):
            apollo79_prior(models, weights=weights[1:])

    def test_cars_held_out_one_by_one(self, models):
        none, two, five = leave_one_out(models, (0, 2, 5))
        assert 100 * np.array([none.keypoint_rms, two.keypoint_rms, five.keypoint_rms]) == pytest.approx(
            [21.4, 8.8, 6.1], abs=0.05
        )
        assert 100 * five.vertex_rms == pytest.approx(5.4, abs=0.05)
        assert five.explained == pytest.approx(0.933, abs=5e-4)

    def test_offset_sigma_is_what_held_out_cars_show(self, models):
        """Within 8 % for every keypoint, on cars left out in ten groups."""
        kept = np.flatnonzero(np.arange(79) != models.index(DUPLICATE[1:])[0])
        left = []
        for group in np.array_split(np.random.default_rng(0).permutation(kept), 10):
            prior = apollo79_prior(models, exclude=[models.names[i] for i in group])
            left.append(express(prior, models.keypoints[group])[1])
        held_out = np.sqrt((np.concatenate(left) ** 2).mean(axis=(0, 2)))
        assert PRIOR.offset_sigma == pytest.approx(held_out, rel=0.08)

    def test_files_that_cannot_be_used(self, tmp_path):
        with pytest.raises(InvalidInputError, match="apollo79_car14"):
            load_apollo79(tmp_path)
        (tmp_path / "other.npz").write_bytes(b"not an archive")
        with pytest.raises(InvalidInputError, match="unreadable"):
            load_apollo79(tmp_path / "other.npz")
        np.savez(tmp_path / "other.npz", keypoints=np.zeros(3))
        with pytest.raises(InvalidInputError, match="car_names"):
            load_apollo79(tmp_path / "other.npz")


@pytest.mark.data
def test_kitti_size_prior_is_that_of_the_training_labels(data):
    folder = data / "kitti_object"
    labels = folder / "training" / "label_2"
    found, _ = read_labels(labels, read_image_set(folder / "ImageSets" / "train.txt"))
    sizes = np.concatenate([objects.size[np.array(objects.kind) == "Car"] for objects in found.values()])
    assert len(sizes) == 14357
    assert SIZE_PRIORS["kitti"].mean == pytest.approx(np.mean(sizes, axis=0), abs=0.005)
    assert SIZE_PRIORS["kitti"].sigma == pytest.approx(np.std(sizes, axis=0), abs=0.005)
    assert (SIZE_PRIORS["kitti"].assumed_sigma <= SIZE_PRIORS["kitti"].sigma).all()
    traffic = np.concatenate([objects.size[np.isin(objects.kind, ("Car", "Van"))] for objects in found.values()])
    assert len(traffic) == 15654
    off = traffic - SIZE_PRIORS["kitti"].mean
    np.testing.assert_allclose(SIZE_PRIORS["kitti"].spread, off.T @ off / len(off), atol=0.0005)
