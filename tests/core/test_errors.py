"""Errors come whole from worker processes: pickled and copied they say the same."""

import copy
import pickle

import numpy as np
import pytest

from fgrecon import errors
from fgrecon.batch.pool import WorkerDiedError

MADE = [
    errors.FgreconError("solving failed"),
    errors.InvalidInputError("box", [1, 2], "Give four numbers."),
    errors.InvalidInputError("box", np.arange(100), "Give four numbers."),
    errors.InvalidInputError("box", None, "Give four numbers."),
    errors.DegenerateProblemError("keypoints", 3, "Give more."),
    errors.FactorCallbackError("not finite"),
    errors.MissingPackageError("mcap", "Writing MCAP"),
    errors.ChildNotBegunError("out of memory"),
    errors.AssumedCameraWarning("distances are rough"),
    errors.DamagedFileWarning("part-000001 is damaged"),
    errors.ContradictoryInputWarning("All keypoints are between 0 and 1."),
    errors.UncoveredFramesWarning("3 of 8 frames have no pose."),
    WorkerDiedError("a worker died four times"),
]


@pytest.mark.parametrize("again", [copy.copy, copy.deepcopy, lambda error: pickle.loads(pickle.dumps(error))])
@pytest.mark.parametrize("error", MADE, ids=lambda error: type(error).__name__)
def test_an_error_stays_what_it_is(error, again):
    made = again(error)
    assert (type(made), str(made)) == (type(error), str(error))
    fields, expected = dict(vars(made)), dict(vars(error))
    if not isinstance(expected.get("value", ""), str | int | None):  # what is not plain goes as its text
        assert fields.pop("value") in str(error)
        del expected["value"]
    assert fields == expected
    again(made)


def test_every_error_is_tried():
    assert {getattr(errors, name) for name in errors.__all__} <= {type(error) for error in MADE}
