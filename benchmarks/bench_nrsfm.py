"""Learn shape priors from real 2D annotations and measure them: the tables of docs/explanation/learnt-priors.md.

    OMP_NUM_THREADS=1 python benchmarks/bench_nrsfm.py [--data ../shared/data] [--part PART] [--repeats N]

Parts: small, all, heldout, points36, variance, few. All but the last leave the proportions as the images tell them.

Mean-shape errors are RMS distances over the keypoints after a similarity alignment, in percent of the length of the
reference's box; times are CPU seconds of one process.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.shape_errors import expression_error, mean_error
from fgrecon.core.arrays import Array
from fgrecon.core.category import Category
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SIZE_PRIORS
from fgrecon.io.catalogue import load_category, load_prior
from fgrecon_research.io.annotations import Annotations, load_annotations, spread
from fgrecon_research.paper.icra2017 import import_icra2017
from fgrecon_research.training.priors.compare import align, compare_priors
from fgrecon_research.training.priors.learn import PROPORTIONS, LearntPrior, learn_prior, to_prior
from fgrecon_research.training.priors.nrsfm import NrsfmOptions

DEFAULT = NrsfmOptions(bootstrap=0)
VARIANTS = {
    "default": DEFAULT,
    "perspective removed": replace(DEFAULT, perspective=True),
    "Gaussian noise": replace(DEFAULT, dof=None),
    "plain likelihood": replace(DEFAULT, restricted=False),
    "plain and Gaussian (Torresani)": replace(DEFAULT, restricted=False, dof=None),
    "no symmetry": replace(DEFAULT, symmetric=False),
    "mirrored copies": replace(DEFAULT, symmetric=False),
    "rigid": replace(DEFAULT, basis=0),
    "3 vectors": replace(DEFAULT, basis=3),
    "8 vectors": replace(DEFAULT, basis=8),
}
TITLES = {
    "small": "300 images",
    "all": "All images",
    "heldout": "Held-out keypoints, 300 images, % of the visible points' extent",
    "points36": "36 points, 300 images",
    "few": "37 random vehicles, 300 images of them",
    "variance": "Share of the variance of ten vectors, 300 images",
}
CAD12 = [0, 1, 2, 3, 4, 5, 6, 7, 10, 11, 12, 13]
"""Places in car14 of the 12 keypoints of cad_keypoints12, which has no mirrors."""


def cad12_error(prior: ShapePrior, shapes: Array) -> float:
    """Mean-shape error against unit-sized shapes (x forward, y up, z right), percent of their length."""
    real = shapes.mean(axis=0) * [1.0, -1.0, -1.0]
    difference = align(prior.mean[CAD12], real)[0] - real
    length = (real[[4, 5], 0].mean() - real[[6, 7], 0].mean()) / prior.category.dimensions[0].ratio
    return 100.0 * float(np.sqrt(np.square(difference).sum(axis=1).mean())) / length


def with_mirrored_copies(category: Category, keypoints: Array) -> Array:
    """The images and their mirror images, left and right keypoints exchanged."""
    return np.concatenate([keypoints, keypoints[:, category.mirror] * [-1.0, 1.0]])


def learn(annotations: Annotations, variant: str, seed: int = 0) -> tuple[LearntPrior, float]:
    """A prior and the CPU seconds that it took."""
    keypoints, views = annotations.keypoints, annotations.views
    if variant == "mirrored copies":
        keypoints = with_mirrored_copies(annotations.category, keypoints)
        views = None if views is None else np.tile(views, 2)
    begun = time.process_time()
    how = {"options": replace(VARIANTS[variant], seed=seed), "proportions": 0.0}  # what the images tell alone
    learnt = learn_prior(Annotations(annotations.category, keypoints, views=views), **how)
    return learnt, time.process_time() - begun


def per_keypoint(category: Category, difference: Array) -> str:
    """Differences of the left keypoints in centimetres, in words."""
    left = [pair[0] for pair in category.symmetric_pairs]
    return "; ".join(f"{category.keypoints[k]} {', '.join(f'{100 * x:+.0f}' for x in difference[k])}" for k in left)


def small(data: Path, subsets: int) -> None:
    """300 images, several choices of them, every variant."""
    annotations = veri14(data)
    cars, cad = apollo(data), np.load(data / "cad_keypoints12/pca_3d_cad.npy")[..., 3:]
    heads("variant", "mean error, % of apollo79", "% of cad12", "held-out car, cm", "noise, cm", "CPU s")
    for variant in VARIANTS:
        rows = []
        for seed in range(subsets):
            chosen = annotations.select(spread(annotations, 300, np.random.default_rng(seed)))
            learnt, seconds = learn(chosen, variant)
            error = mean_error(learnt.prior, cars)[1]
            expressed = 100 * expression_error(learnt.prior, cars).mean()
            sigma = 100 * float(learnt.prior.offset_sigma.mean())
            rows.append((error, cad12_error(learnt.prior, cad), expressed, sigma, seconds))
        table = np.array(rows)
        mean = table.mean(axis=0)
        errors = " ".join(f"{x:.2f}" for x in table[:, 0])
        print(
            f"| {variant} | {mean[0]:.2f} ({errors}) | {mean[1]:.2f} | {mean[2]:.1f} | {mean[3]:.1f} | {mean[4]:.1f} |",
            flush=True,
        )
    pca = load_prior("car14")
    rigid, own = pca.truncated(0), expression_error(pca, cars)
    print(f"| PCA of apollo79 itself | 0 | {cad12_error(pca, cad):.2f} | {100 * own.mean():.1f} (in sample) | | |")
    print(f"| mean of apollo79 alone | 0 | | {100 * expression_error(rigid, cars).mean():.1f} | | |")


def every(data: Path, seeds: int) -> None:
    """All images with at least eight annotated keypoints."""
    annotations = veri14(data)
    cars, cad = apollo(data), np.load(data / "cad_keypoints12/pca_3d_cad.npy")[..., 3:]
    differences = {}
    heads("variant", "mean error, % of apollo79", "% of cad12", "held-out car, cm", "CPU s")
    for variant in ("default", "perspective removed"):
        for seed in range(seeds):
            learnt, seconds = learn(annotations, variant, seed)
            _, error, differences[variant] = mean_error(learnt.prior, cars)
            expressed = 100 * expression_error(learnt.prior, cars).mean()
            print(
                f"| {variant}, {int(learnt.nrsfm.used.sum())} images, seed {seed} | {error:.2f} "
                f"| {cad12_error(learnt.prior, cad):.2f} | {expressed:.1f} | {seconds:.0f} |",
                flush=True,
            )
    print("\nLearnt less mean of apollo79, cm (forward, down, left), left keypoints:\n")
    for variant, difference in differences.items():
        print(f"- {variant}: {per_keypoint(annotations.category, difference)}")


def heldout(data: Path, repeats: int) -> None:
    """A tenth of the keypoints hidden at random, predicted in percent of the visible ones' larger extent."""
    annotations, medians = veri14(data), ""
    heads("variant", "points", "median", "75 %", "90 %", "mean", "beyond 15 %, %")
    for variant in ("default", "perspective removed", "plain and Gaussian (Torresani)", "rigid"):
        errors, places = [], []
        for seed in range(repeats):
            rng = np.random.default_rng(seed)
            chosen = annotations.select(spread(annotations, 300, rng, min_visible=9))
            hidden = chosen.seen & (rng.random(chosen.seen.shape) < 0.1)
            visible = np.where(hidden[:, :, None], np.nan, chosen.keypoints)
            learnt, _ = learn(replace(chosen, keypoints=visible), variant)
            used = learnt.nrsfm.used
            extent = (np.nanmax(visible, axis=1) - np.nanmin(visible, axis=1)).max(axis=1)[used]
            error = np.linalg.norm(learnt.nrsfm.predict() - chosen.keypoints[used], axis=2) / extent[:, None]
            errors.append(error[hidden[used]])
            places.append(np.nonzero(hidden[used])[1])
        error, place = 100 * np.concatenate(errors), np.concatenate(places)
        quartile, ninety = np.percentile(error, [75, 90])
        print(
            f"| {variant} | {len(error)} | {np.median(error):.2f} | {quartile:.2f} | {ninety:.1f} "
            f"| {error.mean():.2f} | {100 * (error > 15).mean():.1f} |",
            flush=True,
        )
        if variant == "default":
            names = annotations.category.keypoints
            medians = "; ".join(f"{names[k]} {np.median(error[place == k]):.1f}" for k in range(len(names)))
    print(f"\nMedian per keypoint, default: {medians}.")


def points36(data: Path, subsets: int) -> None:
    """36 points against the authors' mean shape and the 36 points of the 79 car models."""
    category = load_category("car36")
    annotations = load_annotations([data / "veri_keypoints36/label_train.csv"], category)
    reference, cars = import_icra2017(data / "icra2017"), np.load(data / "apollo79/apollo79_car36.npz")["keypoints"]
    print(f"The authors' mean against apollo79: {mean_error(reference, cars)[1]:.2f} %.\n")
    heads("variant", "% of icra2017", "each axis scaled", "% of apollo79", "held-out car, cm", "nearness", "CPU s")
    for variant in ("default", "perspective removed"):
        for seed in range(subsets):
            chosen = annotations.select(spread(annotations, 300, np.random.default_rng(seed)))
            learnt, seconds = learn(chosen, variant)
            own = compare_priors(learnt.prior, reference)
            print(
                f"| {variant}, seed {seed} | {own.percent:.2f} | {axis_scaled(learnt.prior, reference):.2f} "
                f"| {mean_error(learnt.prior, cars)[1]:.2f} | {100 * expression_error(learnt.prior, cars).mean():.1f} "
                f"| {learnt.nrsfm.nearness:.3f} | {seconds:.1f} |",
                flush=True,
            )


def axis_scaled(prior: ShapePrior, reference: ShapePrior) -> float:
    """Mean-shape error with each axis scaled on its own (the authors' proportions are not metric), percent."""
    ours, theirs = (p.mean - p.mean.mean(axis=0) for p in (prior, reference))
    factors = (ours * theirs).sum(axis=0) / np.square(ours).sum(axis=0)
    rms = np.sqrt(np.square(ours * factors - theirs).sum(axis=1).mean())
    return 100.0 * float(rms / reference.box_size(np.zeros(reference.dimension))[0])


def variance(data: Path) -> None:
    """Share of the variance of 10 learnt vectors, per data set; and of the 3D shapes themselves."""
    car14, car36 = veri14(data), load_annotations([data / "veri_keypoints36/label_train.csv"], load_category("car36"))
    heads("learnt from", "vectors 1 to 10, %", "first five, % of all", "of the ten")
    for name, marked in (("veri_keypoints14", car14), ("veri_keypoints36", car36)):
        chosen = marked.select(spread(marked, 300, np.random.default_rng(0)))
        for perspective in (False, True):
            options = replace(DEFAULT, basis=10, perspective=perspective)
            how = {"options": options, "proportions": 0.0}
            prior = learn_prior(replace(chosen, vehicles=None), **how).prior
            share = prior.explained
            shares = " ".join(f"{100 * x:.1f}" for x in share)
            kind = f"{name}{', perspective removed' if perspective else ''}"
            five = share[:5].sum()
            print(f"| {kind} | {shares} | {100 * five:.2f} | {100 * five / share.sum():.2f} |", flush=True)


def few(data: Path, subsets: int) -> None:
    """A fifth of the vehicles: with the proportions that images tell, with the default, and how sure it says to be."""
    annotations, cars = veri14(data), apollo(data)
    heads("choice", "as the images tell, % of apollo79", "default", "size prior `kitti`", "says, cm")
    names = np.unique(np.asarray(annotations.vehicles))
    for seed in range(subsets):
        vehicles = np.random.default_rng(1000 + seed).permutation(names)[:37]
        own = annotations.select(np.isin(annotations.vehicles, vehicles))
        chosen = own.select(spread(own, 300, np.random.default_rng(seed)))
        learnt = learn_prior(chosen)
        priors = [
            to_prior(chosen.category, learnt.nrsfm, SIZE_PRIORS[fleet], proportions=share).prior
            for fleet, share in (("apollo79", 0.0), ("apollo79", PROPORTIONS), ("kitti", PROPORTIONS))
        ]
        errors = " | ".join(f"{mean_error(prior, cars)[1]:.2f}" for prior in priors)
        sure = 100 * float(np.sqrt(np.square(priors[1].mean_sigma).sum(axis=1).mean()))
        print(f"| {seed} | {errors} | {sure:.1f} |", flush=True)


def heads(*names: str) -> None:
    """The first two lines of a Markdown table; its first column is text."""
    print(f"| {' | '.join(names)} |\n| --- |{' ---: |' * (len(names) - 1)}")


def veri14(data: Path) -> Annotations:
    """The 9,671 images with 14 keypoints."""
    return load_annotations([data / "veri_keypoints14/keypoints.npz"], load_category("car14"))


def apollo(data: Path) -> Array:
    """(79, 14, 3) keypoints of the 79 car models."""
    return np.asarray(np.load(data / "apollo79/apollo79_car14.npz")["keypoints"])


def main() -> None:
    """Run the parts that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--part", action="append", choices=list(TITLES))
    parser.add_argument("--repeats", type=int, default=4, help="choices of images, or seeds")
    arguments = parser.parse_args()
    parts = arguments.part or [part for part in TITLES if part != "few"]  # that is on the page itself
    for part in parts:
        print(f"\n### {TITLES[part]}\n", flush=True)
        if part == "small":
            small(arguments.data, arguments.repeats)
        elif part == "all":
            every(arguments.data, min(arguments.repeats, 2))
        elif part == "heldout":
            heldout(arguments.data, arguments.repeats)
        elif part == "points36":
            points36(arguments.data, min(arguments.repeats, 2))
        elif part == "few":
            few(arguments.data, arguments.repeats)
        else:
            variance(arguments.data)


if __name__ == "__main__":
    main()
