"""Probability of a result's pose, and of each alternative that explains its keypoints.

Which way a vehicle faces is the detector's directions to say, where it has any; the energies add nothing to them. What
else tells poses apart is their energy, but keypoints err together, so that a nat of it is worth less than a nat of
evidence: by a temper, which makes the poses of one facing as probable as they are on KITTI's video. Keypoints
without directions leave facings to the energies as well, by a logistic law that was fitted to 4,200 simulated vehicles
(expected calibration error 0.001 there). A detector that turns more vehicles round than the simulated one is less sure.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.half_turn import flipped_alternative
from fgrecon.core.reconstruction import Alternative
from fgrecon.solve.graph.mode_selection import is_flipped
from fgrecon.solve.solve_settings import STATUS


def facing_by_energies(camera_T_object: NDArray[np.float64], alternatives: Sequence[Alternative]) -> float:
    """How probably a pose (4, 4) faces the right way where energies alone tell; NaN where there are none."""
    turned = [other.excess for other in alternatives if is_flipped(other.camera_T_object, camera_T_object)]
    if any(math.isnan(other.excess) for other in alternatives):
        return float("nan")
    margin = min([STATUS.facing_margin_nats, *turned])
    return 1.0 / (1.0 + math.exp(-STATUS.facing_log_odds - STATUS.facing_log_odds_per_nat * margin))


def with_probabilities(
    camera_T_object: NDArray[np.float64],
    coefficients: NDArray[np.float64],
    alternatives: Sequence[Alternative],
    facing: float,
) -> tuple[Alternative, ...]:
    """The other poses with their probabilities; what is left of one is the result's own.

    Args:
        camera_T_object: (4, 4) the result's pose.
        coefficients: (N,) its shape.
        alternatives: Other poses, best first.
        facing: How probably the result faces the right way; NaN where nobody knows: no probabilities then.

    Returns:
        The poses. Where none of them faces the other way, though that may well be so, the last one does.
    """
    if math.isnan(facing) or any(math.isnan(other.excess) for other in alternatives):
        return tuple(alternatives)
    others = list(alternatives)
    turned = [is_flipped(other.camera_T_object, camera_T_object) for other in others]
    if not any(turned) and 1.0 - facing >= STATUS.facing_probability:
        others += flipped_alternative(camera_T_object, coefficients, facing)
        turned += [True] * (len(others) - len(turned))
    if not others:
        return ()
    odds = np.exp(-STATUS.energy_temper * np.array([other.excess for other in others]))
    there = np.array(turned, dtype=bool)
    share = np.where(there, (1.0 - facing) / max(odds[there].sum(), 1e-300), facing / (1.0 + odds[~there].sum()))
    pairs = zip(others, (share * odds).tolist(), strict=True)
    return tuple(Alternative(one.camera_T_object, one.coefficients, one.excess, p) for one, p in pairs)
