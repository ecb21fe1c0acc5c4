"""What is not known of the camera's motion, as a covariance of the poses that it carries along."""

import gtsam
import numpy as np

from fgrecon.solve.time.window import FrameStep
from tests.solve.time.streets import upright


def test_a_pose_is_as_unsure_as_the_motion_that_carries_it():
    """Against many motions drawn: how far the vehicle is off, in its own frame."""
    rng = np.random.default_rng(0)
    sigmas = np.array([1e-3, 2e-3, 5e-4, 0.01, 0.005, 0.1])
    pose = gtsam.Pose3(upright(0.8, [3.0, 1.6, 25.0]))
    step = FrameStep(0.1, gtsam.Pose3(), np.diag(sigmas**2))
    drawn = []
    for error in rng.normal(size=(20000, 6)) * sigmas:
        moved = gtsam.Pose3.Expmap(error).compose(pose)
        drawn.append(gtsam.Pose3.Logmap(pose.between(moved)))
    expected = np.cov(np.array(drawn).T)
    found = step.carried(pose)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(found / scale, expected / scale, atol=0.05)
