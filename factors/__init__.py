"""GTSAM factors for the pose and shape of vehicles; depends on gtsam and numpy alone.

The graph of one vehicle in one frame; boxes are variables (`factors.keys`), the rest are factors::

                 upright (3)                        dimensions (3)   coefficients prior (N)
                     |                                     |          |
                     |      reprojection, 2 per keypoint   |          |
                 +--------+      cheirality (1)        +--------+     |
    ground ------| X(v,t) |------- box (4) ------------|  L(v)  |-----+
    height (1)   +--------+            |               +--------+
                                       |                |  |  |
                                       |   +------------+  |  +--- Laplacian (3 per keypoint),
                                       |   |               |       rectangularity (4 per face)
                                    +--------+             |        |
     offsets prior (3K) ------------|  O(v)  |-------------+--------+
                                    +--------+             |
                                       |                   |
                                       +----- planarity (1 per keypoint of the face) ----- [ P(v,f) ] --- ground-
                                       |                   |                                              parallel (2)
                                       +----- symmetry (3 per pair) ---------------------- [  M(v)  ]

A second frame adds X(v, t + 1) with reprojection, cheirality, box and ground factors of its own on the same L(v).

Reprojection, cheirality, box and ground of a frame are one factor (`observation_factor`; `term_factor` has one of its
terms), and where the kernels are compiled three of the shape's terms are another (`factors.shape_terms`); each term of
the shape has a factor of its own as well. `LinearShape` evaluates X(lambda, offsets) once per linearisation point for
all of them. O(v) is optional, and every factor also works with the pose, lambda or the offsets held constant. Where the
focal length is not known, F(t) is a variable of every factor that projects. Every callback passes through
`factors.guard`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from factors.lazy import lazy_names

if TYPE_CHECKING:  # imported when used
    from factors.box import BoxRows
    from factors.contact import GroundFrame, contact_factor
    from factors.detected_box import detected_origin_factor, detected_yaw_factor
    from factors.dimensions import dimensions_factor
    from factors.errors import DegenerateProblemError, FactorCallbackError, FgreconError, InvalidInputError
    from factors.ground import GroundRows
    from factors.ground_transition import ground_transition_factor
    from factors.guard import guarded_factor
    from factors.keypoint_rows import KeypointRows, whiteners
    from factors.keys import D, DecodedKey, F, G, L, M, O, P, S, V, X, decode_key, key_name
    from factors.laplacian import laplacian_factor
    from factors.losses import Loss, RobustLoss
    from factors.marginals import Marginal, marginal, marginal_factor
    from factors.mixture import Form, mixture
    from factors.motion import drive_factor, motion_factor
    from factors.noise import Noise, as_noise, diagonal_noise, full_noise
    from factors.observation_rows import (
        ObservationRows,
        check_in_front,
        observation_factor,
        reprojection_factor,
        term_factor,
    )
    from factors.planarity import ground_parallel_factor, planarity_factor
    from factors.planes import fit_plane, make_plane
    from factors.projection_kernel import Projection, ProjectionKernel
    from factors.rectangularity import rectangularity_factor
    from factors.shape import LinearShape
    from factors.shape_factor import ShapeContext, ShapeTerm, shape_factor
    from factors.shape_prior import coefficients_prior, offsets_prior
    from factors.symmetry import symmetry_factor

__all__ = [
    "BoxRows",
    "D",
    "DecodedKey",
    "DegenerateProblemError",
    "F",
    "FactorCallbackError",
    "FgreconError",
    "Form",
    "G",
    "GroundFrame",
    "GroundRows",
    "InvalidInputError",
    "KeypointRows",
    "L",
    "LinearShape",
    "Loss",
    "M",
    "Marginal",
    "Noise",
    "O",
    "ObservationRows",
    "P",
    "Projection",
    "ProjectionKernel",
    "RobustLoss",
    "S",
    "ShapeContext",
    "ShapeTerm",
    "V",
    "X",
    "as_noise",
    "check_in_front",
    "coefficients_prior",
    "contact_factor",
    "decode_key",
    "detected_origin_factor",
    "detected_yaw_factor",
    "diagonal_noise",
    "dimensions_factor",
    "drive_factor",
    "fit_plane",
    "full_noise",
    "ground_parallel_factor",
    "ground_transition_factor",
    "guarded_factor",
    "key_name",
    "laplacian_factor",
    "make_plane",
    "marginal",
    "marginal_factor",
    "mixture",
    "motion_factor",
    "observation_factor",
    "offsets_prior",
    "planarity_factor",
    "rectangularity_factor",
    "reprojection_factor",
    "shape_factor",
    "symmetry_factor",
    "term_factor",
    "whiteners",
]

__docformat__ = "google"  # for the API reference

__getattr__, __dir__ = lazy_names(__name__)
