"""Learning a shape prior from images with annotated keypoints, each of another car.

Nothing but 2D annotations goes in; here they are simulated, in your case people made them (COCO, PASCAL3D+, CSV: see
`fgrecon prior learn --help`). Non-rigid structure from motion explains image m by a camera and by coefficients; the
mean, the basis vectors and the noise are common to all. As a factor graph:

    N(0, I) ---- lambda(m) ----+
                               |
               camera(m) ---- reprojection_i(m) ---- mean, basis, noise
                               |
                 every annotated keypoint i of image m
"""

import numpy as np

import fgrecon
from fgrecon.simulation import KITTI_CAMERA, Vehicle, yaw_pose
from fgrecon_research.training import Annotations, NrsfmOptions, compare_priors, learn_prior


def main() -> None:
    rng = np.random.default_rng(0)
    true = fgrecon.load_prior("car14")
    annotations = Annotations(true.category, np.array([annotate(true, rng) for _ in range(150)]))

    learnt = learn_prior(annotations, options=NrsfmOptions(basis=3, restarts=1), name="mine")

    prior = learnt.prior
    compared = compare_priors(prior, true)
    print(
        f"{prior.name}: {prior.dimension} vectors, mean length, width, height {prior.box_size(np.zeros(3)).round(2)} m"
    )
    print(f"mean shape off by {100 * compared.rms:.1f} cm, {compared.percent:.1f} percent of the length")

    car = Vehicle.sample(true, rng)  # use it: any prior goes where the name of a shipped one goes
    pose = yaw_pose(yaw=-2.1, location=np.array([-2.0, 1.65, 10.0]))
    pixels = KITTI_CAMERA.project(car.keypoints @ pose[:3, :3].T + pose[:3, 3])
    result = fgrecon.reconstruct(pixels, KITTI_CAMERA, prior=prior, ground=1.65)
    print(f"{result.status}: yaw {np.degrees(result.rotation_y):.1f} degrees, true {np.degrees(-2.1):.1f}")


def annotate(prior: fgrecon.ShapePrior, rng: np.random.Generator) -> np.ndarray:
    """What a person would mark: the keypoints (K, 2) of a car of its own from somewhere, unseen ones NaN."""
    car = Vehicle.sample(prior, rng)
    pose = yaw_pose(rng.uniform(-np.pi, np.pi), np.array([rng.uniform(-3.0, 3.0), 2.5, 25.0]))
    pixels = KITTI_CAMERA.project(car.keypoints @ pose[:3, :3].T + pose[:3, 3]) + rng.normal(0.0, 0.5, (14, 2))
    pixels[rng.random(14) < 0.25] = np.nan
    return pixels


if __name__ == "__main__":
    main()
