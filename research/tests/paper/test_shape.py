"""The shape experiment: fair to held-out cars, and showing what it is meant to show."""

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from fgrecon.cli.main import app
from fgrecon.core.camera import Ground
from fgrecon.core.category import Category
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.options import Options, ShapeOptions
from fgrecon.core.robust import StrategyName
from fgrecon_research.evaluation.methods import select
from fgrecon_research.paper.shape import (
    ABSENT,
    BIAS,
    STAGES,
    STRATEGIES,
    held_out,
    score_shape,
    score_strategy,
    simulate_views,
    strategies,
    unsymmetrised_prior,
    variants,
)
from fgrecon_research.training.priors.apollo79 import DUPLICATE, apollo79_prior, load_apollo79

pytestmark = pytest.mark.data
GROUND = Ground.level(1.65)
LOOSE = Options(shape=ShapeOptions(laplacian_sigma=0.6))


@pytest.fixture(scope="module")
def models(data):
    return load_apollo79(data)


@pytest.fixture(scope="module")
def names(models):
    return held_out(models)


@pytest.fixture(scope="module")
def prior(models, names):
    return apollo79_prior(models, exclude=names)


@pytest.fixture(scope="module")
def scores(models, names, prior):
    return score_shape(simulate_views(models, names, 3), prior, LOOSE, ground=GROUND)


class TestHeldOut:
    def test_takes_both_names_of_one_car_or_neither(self, models):
        together = 0
        for seed in range(40):
            names = held_out(models, 20, seed)
            assert len(names) == len(set(names)) == 20
            assert (DUPLICATE[0] in names) == (DUPLICATE[1] in names)
            together += DUPLICATE[0] in names
        assert 0 < together < 40
        assert held_out(models, 20, 3) == held_out(models, 20, 3) != held_out(models, 20, 4)

    def test_refuses_to_hold_out_everything(self, models):
        with pytest.raises(InvalidInputError, match="count"):
            held_out(models, 79)

    def test_views_are_of_the_cars_held_out_and_no_car_counts_twice(self, models):
        views = simulate_views(models, DUPLICATE, 2)
        assert len(views) == 2
        for _, truth in views:
            assert (truth.vehicle.keypoints == models.keypoints[models.index(DUPLICATE[:1])[0]]).all()


class TestScores:
    def test_before_is_the_mean_shape(self, scores, prior, models, names):
        assert tuple(scores) == STAGES
        cars = [name for name in names if name != DUPLICATE[1] or DUPLICATE[0] not in names]
        truth = models.keypoints[models.index(cars)]
        expected = np.median(np.linalg.norm(prior.mean - truth, axis=2))
        assert scores["mean, true pose"].keypoint == pytest.approx(expected)
        assert scores["mean, estimated pose"].keypoint == pytest.approx(expected)
        assert scores["mean, true pose"].orientation == pytest.approx(0.0, abs=1e-5)

    def test_shape_stage_lowers_the_3d_error_and_not_the_fit(self, scores):
        at_truth, at_estimate = scores["mean, true pose"], scores["mean, estimated pose"]
        shares = {
            "shape, true pose": (at_truth, 0.9),
            "shape, pose fixed": (at_estimate, 0.9),
            "joint": (at_estimate, 0.85),
        }
        for stage, (before, share) in shares.items():
            assert scores[stage].keypoint <= share * before.keypoint
            assert scores[stage].reprojection <= before.reprojection

    def test_without_noise_the_shape_is_found_at_the_true_pose(self, prior, models, names):
        """What is left is what five vectors cannot express."""
        views = simulate_views(models, names[:4], 2)
        exact = [(replace(observation, keypoints=truth.projections), truth) for observation, truth in views]
        noisy, clean = (score_shape(part, prior, LOOSE)["shape, true pose"].keypoint for part in (views, exact))
        assert clean < noisy


class TestAblation:
    def test_unsymmetrised_prior_is_biased_noisy_and_free(self, models, names, prior):
        loose = unsymmetrised_prior(models, names)
        assert prior.is_symmetric
        assert not loose.is_symmetric
        off = loose.mean - models.keypoints_mesh.mean(axis=0)
        assert off.std() == pytest.approx(BIAS, rel=0.4)
        assert (loose.offset_sigma > BIAS).all()

    def test_variants_switch_one_thing_each(self):
        settings = variants(Options())
        assert len(settings) == len(set(Options.TERMS) - ABSENT) + 3
        off = Options().disabled_terms
        assert off
        for term in set(Options.TERMS) - ABSENT:
            name = f"{'with' if term in off else 'without'} {term}"
            assert settings[name].disabled_terms ^ off == {term}
        assert not settings["without free offsets"].shape.free_offsets
        literal = settings["with the Laplacian as printed"]
        assert literal.shape.literal_laplacian
        assert "laplacian" not in literal.disabled_terms

    def test_symmetry_and_planarity_do_nothing_where_the_prior_has_them(self, models, names, prior):
        """No face here need be parallel to the ground, so that nothing but planarity is switched off."""
        views = simulate_views(models, names[:3], 1)
        category = _without_ground_parallel(prior.category)
        free = replace(prior, category=category)
        table = {name: score_shape(views, free, s) for name, s in variants(LOOSE).items() if name in _VANISHING}
        assert len({rows["joint"] for rows in table.values()}) == 1

    def test_symmetry_and_planarity_help_where_the_prior_lacks_them(self, models, names):
        prior = unsymmetrised_prior(models, names)
        views = simulate_views(models, names, 2)
        free = replace(LOOSE, shape=replace(LOOSE.shape, free_offsets=True))
        with_, without = (
            score_shape(views, prior, replace(free, disabled_terms=frozenset(off)), ground=GROUND)
            for off in ((), ("symmetry", "planarity"))
        )
        for stage in ("shape, true pose", "joint"):
            assert with_[stage].keypoint < 0.98 * without[stage].keypoint


class TestStrategies:
    def test_every_strategy_is_scored(self, models, names, prior):
        views, settings = simulate_views(models, names[:2], 1), strategies(Options())
        assert tuple(settings) == STRATEGIES
        assert set(STRATEGIES) == {name.value for name in StrategyName} | {"none"}
        scores = {name: score_strategy(views, prior, setting) for name, setting in settings.items()}
        assert scores["mixture"].mean < 20.0
        assert all(0.0 <= score.mean <= 180.0 for score in scores.values())

    def test_a_method_may_name_its_strategy(self):
        names = ["fgrecon+ground+size:paper", "fgrecon:none", "sqpnp"]
        assert [method.name for method in select(names)] == names
        for bad in ("fgrecon:magic", "sqpnp:paper", "magic:paper"):
            with pytest.raises(InvalidInputError):
                select([bad])


def test_command(data, tmp_path):
    out, table = tmp_path / "shape.json", tmp_path / "shape.md"
    options = ["--data", str(data), "--cars", "2", "--views", "1", "--no-ablation"]
    result = CliRunner().invoke(app, ["evaluate", "shape", *options, "--json", str(out), "--markdown", str(table)])
    assert result.exit_code == 0
    document = json.loads(out.read_text())
    assert tuple(document["stages"]) == STAGES
    assert document["settings"]["views"] == 2
    assert "| joint |" in table.read_text()
    assert "2 views of cars held out" in result.output


_VANISHING = ("all terms", "without symmetry", "without planarity")


def _without_ground_parallel(category: Category) -> Category:
    return replace(category, faces=tuple(replace(face, ground_parallel=False) for face in category.faces))
