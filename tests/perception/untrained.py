"""Keypoint networks that have learnt nothing: arrays of the right shapes, drawn at random."""

import numpy as np

from fgrecon.perception.keypoints.decode import ConfidenceCalibration
from fgrecon.perception.keypoints.layout import KNetLayout, RefineLayout
from fgrecon.perception.keypoints.network_file import Stored


def untrained_arrays(layout, seed=0):
    """Arrays by name; normalisations change nothing."""
    rng, arrays = np.random.default_rng(seed), {}
    for name, shape in layout.shapes.items():
        inputs = max(int(np.prod(shape[1:])), 1)
        values = rng.uniform(-1.0, 1.0, shape) / np.sqrt(inputs)
        if ".norm." in name:
            values = np.full(shape, float(name.endswith(("weight", "running_var"))))
        arrays[name] = values.astype(np.float32)
    return arrays


def untrained(sizes, finer=None, calibration=None, **fields):
    """A network of these sizes, and refinement networks where theirs are given, as they are stored."""
    refinement = None if finer is None else untrained_arrays(RefineLayout.of(finer), 1)
    return Stored(
        untrained_arrays(KNetLayout.of(sizes)),
        sizes.to_dict(),
        ConfidenceCalibration() if calibration is None else calibration,
        **{"provenance": {}, **fields},
        refinement=refinement,
        refine_settings=None if finer is None else finer.to_dict(),
    )
