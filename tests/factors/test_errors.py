"""Typed errors go through pickles, as between processes."""

import pickle

import numpy as np
import pytest

from factors.errors import DegenerateProblemError, InvalidInputError


@pytest.mark.parametrize("kind", [InvalidInputError, DegenerateProblemError])
@pytest.mark.parametrize("value", ["text", 3.5, None, np.arange(5), lambda: None], ids=lambda v: type(v).__name__)
def test_an_error_arrives_as_it_was_sent(kind, value):
    error = kind("field", value, "Mend it.")
    back = pickle.loads(pickle.dumps(error))
    assert type(back) is kind
    assert str(back) == str(error)
    assert (back.field, back.fix) == ("field", "Mend it.")
