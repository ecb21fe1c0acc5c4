"""What the numbers say about the paper's claims, in sentences made from the numbers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fgrecon.core.metrics import THRESHOLDS
from fgrecon.evaluation.kitti_devkit import REGIMES
from fgrecon.paper.numbers import PRINTED_MAE
from fgrecon.paper.simulated_scores import CHAIN_ROWS, STAGE_ROWS, Scores
from fgrecon.paper.tables import row_label

__all__ = ["claims", "decoupling_claim", "irls_claim", "ranking_claim"]

_BASELINES = ("aspnp+size", "epnp+size", "sqpnp+size", "sqpnp_confident+size", "poselib_ransac+size")
_CLAIMED = 90.0


def claims(scores: Scores, rows: Sequence[str], chain: Scores, chain_rows: Sequence[str]) -> tuple[str, ...]:
    """What the numbers say about the paper's claims; nothing where a regime has no detected car in what was run."""
    counts = [part.regimes[part.detection >= 0].sum(axis=0) for part in (scores, chain)]
    if not np.all(counts):
        return (
            "No detected car on Easy, Moderate or Hard in this share of the set: of the claims nothing can be said.",
        )
    return (
        irls_claim(scores, rows),
        ranking_claim(scores, rows),
        decoupling_claim(scores, rows, chain, chain_rows),
    )


def irls_claim(scores: Scores, rows: Sequence[str]) -> str:
    """Whether IRLS 'boosts accuracy by more than 90 %', as the paper says, for its own update and for fgrecon's."""
    used = [(scores.detection >= 0) & scores.regimes[:, regime] for regime in range(len(REGIMES))]

    def gains(row: str) -> list[float]:
        pairs = [[float(scores.orientation[u, rows.index(name)].mean()) for name in ("aspnp+size", row)] for u in used]
        return [100.0 * (1.0 - after / before) for before, after in pairs]

    def shown(row: str) -> str:
        return f"{row_label(row)} {' / '.join(f'{gain:.0f}' for gain in gains(row))} %"

    plain, adjusted = PRINTED_MAE["ASPnP"], PRINTED_MAE["Pose adjustment"]
    printed = " / ".join(f"{100.0 * (1.0 - after / before):.0f}" for before, after in zip(plain, adjusted, strict=True))
    verdict = "confirmed" if min(gains("aspnp_irls+size")) > _CLAIMED else "refuted"
    return (
        f"IRLS 'boosts accuracy by more than {_CLAIMED:.0f} %': {verdict}. In the paper the mean orientation error "
        f"falls "
        f"by {printed} % on Easy / Moderate / Hard, from an ASPnP that is no better than chance ({plain[0]:.0f} "
        f"degrees, "
        f"where 90 is chance). On the simulated validation set the mean error of ASPnP on all points falls by: "
        f"{shown('aspnp_irls+size')} (Eqs. 4 and 5); {shown('fgrecon+size')} and {shown('pose')} (a mixture model "
        f"in the "
        f"place of Eq. 5, searched from many starts); and, with no re-weighting at all, "
        f"{shown('sqpnp_confident+size')}."
    )


def ranking_claim(scores: Scores, rows: Sequence[str]) -> str:
    """Where ASPnP + IRLS, and fgrecon's pose stage, do not beat every baseline."""
    parts = []
    for row in ("aspnp_irls+size", "fgrecon+size", "pose"):
        lost: dict[tuple[str, ...], list[str]] = {}
        for index, regime in enumerate(REGIMES):
            used = scores.regimes[:, index]
            for threshold in THRESHOLDS:
                within = scores.orientation[used] <= threshold
                share = {name: float(within[:, rows.index(name)].mean()) for name in (row, *_BASELINES)}
                better = tuple(row_label(name) for name in _BASELINES if share[name] >= share[row])
                lost.setdefault(better, []).append(f"{regime.name} {threshold}°")
        beaten = lost.pop((), [])
        everywhere = len(REGIMES) * len(THRESHOLDS)
        losses = []
        for names, at in lost.items():
            places = "any threshold or regime" if len(at) == everywhere else ", ".join(at)
            losses.append(f"does not beat {' and '.join(names)} at {places}")
        where = "; ".join(losses) if losses else "beats every baseline at every threshold and regime"
        parts.append(
            f"{row_label(row)} {where}" + (f"; it beats all at {', '.join(beaten)}" if losses and beaten else "")
        )
    return (
        f"Ranking. {'. '.join(parts)}. Why the paper's update loses where it does: Eq. (5) ends near "
        "mu2 exp(-e / mean e) + (1 - mu2) w_vis, so with mu2 = 0.7 the worst point of a car keeps a weight of 0.3 "
        "where the pose takes it for visible, and one as far off as the mean more than half. RANSAC, the confidence "
        "threshold "
        "and fgrecon's mixture let a wrong point fall to nothing."
    )


def decoupling_claim(ours: Scores, our_rows: Sequence[str], chain: Scores, chain_rows: Sequence[str]) -> str:
    """Whether solving pose and shape one after the other costs anything."""

    def hard(scores: Scores, rows: Sequence[str], row: str) -> tuple[float, float, float]:
        used = (scores.detection >= 0) & scores.regimes[:, -1]
        r = rows.index(row)
        return (
            float(scores.orientation[used, r].mean()),
            float(np.median(scores.translation[used, r])),
            float(100.0 * np.median(scores.shape[used, r])),
        )

    def against(first: tuple[float, float, float], second: tuple[float, float, float]) -> str:
        return (
            f"{first[0]:.2f} against {second[0]:.2f} degrees, {first[1]:.2f} against {second[1]:.2f} m and "
            f"{first[2]:.1f} against {second[2]:.1f} cm"
        )

    used = (ours.detection >= 0) & ours.regimes[:, -1]
    moved = ours.from_before[used, our_rows.index("sequential")], ours.from_start[used, our_rows.index("pose")]
    small, far = (float(np.mean(distance[np.isfinite(distance)])) for distance in moved)
    ours_both = against(*(hard(ours, our_rows, row) for row in STAGE_ROWS[2:]))
    chain_both = against(*(hard(chain, chain_rows, row) for row in CHAIN_ROWS[1:]))
    return (
        f"Pose and shape decouple. As the paper observes, the shape stage moves the wireframe little: {small:.2f} m on "
        f"average, against {far:.1f} m by the pose stage. That holds of any last step and does not show that the two "
        f"should be solved one after the other. In sequence against jointly (mean orientation error, median position "
        f"error, median keypoint error; Hard): fgrecon, whose pose stage moves the coefficients as well, {ours_both}; "
        f"the paper's chain, whose pose comes from the mean shape, {chain_both}."
    )
