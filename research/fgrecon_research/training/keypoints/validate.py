"""How well a network does on photographs that it does not learn from, while it is trained."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from fgrecon.perception.keypoints.crops import MARGIN
from fgrecon.perception.keypoints.detect import REACH
from fgrecon.perception.keypoints.layout import STRIDE
from fgrecon_research.training.keypoints.augment import Sample, Street
from fgrecon_research.training.keypoints.dataset import Photographs
from fgrecon_research.training.keypoints.labels import SEEN
from fgrecon_research.training.keypoints.views import azimuth_weights

_BATCH = 32
_SEED = 12_000_000  # of the samples


@dataclass(frozen=True)
class HeldOut:
    """Samples of held-out photographs, drawn once."""

    samples: Sequence[Sample]  # degraded as those that are learnt from

    @classmethod
    def draw(
        cls,
        photographs: Photographs,
        held: NDArray[np.intp],
        street: Street,
        partner: NDArray[np.intp],
        seed: int,
        count: int = 192,
    ) -> HeldOut:
        """Draw them, all directions about equally often.

        Args:
            photographs: With labels.
            held: Which of them are held out.
            street: Augmentation.
            partner: (K,) index of each keypoint's mirror image.
            seed: Of the samples.
            count: How many.
        """
        weights = azimuth_weights(photographs.azimuth, held)
        return cls([photographs.draw(held, weights, street, partner, (seed, _SEED + i)) for i in range(count)])

    def score(self, network: Any, device: str = "cpu") -> float:
        """PCK at 0.1: share of visible keypoints that KNet (evaluating) puts so near; NaN if none is."""
        hits: list[NDArray[np.bool_]] = []
        for start in range(0, len(self.samples), _BATCH):
            some = self.samples[start : start + _BATCH]
            crops = torch.from_numpy(np.stack([sample.crop for sample in some])).to(device)
            with torch.inference_mode():
                maps = network(crops.permute(0, 3, 1, 2).float()).maps.float().cpu().numpy()
            row, column = np.divmod(maps.reshape(*maps.shape[:2], -1).argmax(axis=-1), maps.shape[-1])
            places = (np.stack([column, row], axis=-1) + 0.5) * STRIDE - 0.5
            points = np.array([sample.keypoints for sample in some])
            away = np.linalg.norm(places - points, axis=-1) / (maps.shape[-1] * STRIDE / MARGIN)
            seen = (np.array([sample.visible for sample in some]) > SEEN) & np.isfinite(away)
            hits.append((away <= REACH)[seen])
        found = np.concatenate(hits)
        return float(found.mean()) if len(found) else float("nan")
