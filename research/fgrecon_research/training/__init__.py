"""Training of shape priors and networks.

Networks are trained by `fgrecon keypoints train`; see `fgrecon_research.training.keypoints`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from factors.lazy import lazy_names

if TYPE_CHECKING:  # imported when used
    from fgrecon_research.io.annotations import Annotations
    from fgrecon_research.training.priors.compare import PriorComparison, compare_priors
    from fgrecon_research.training.priors.learn import LearntPrior, learn_prior
    from fgrecon_research.training.priors.nrsfm import NrsfmOptions

__all__ = ["Annotations", "LearntPrior", "NrsfmOptions", "PriorComparison", "compare_priors", "learn_prior"]

__getattr__, __dir__ = lazy_names(__name__)
