"""Whatever numbers a history holds, they read back to the last bit."""

from __future__ import annotations

import struct
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fgrecon.viz import replay
from tests.results import changed
from tests.viz.made_up import make_example, record

NUMBERS = st.floats(width=64, allow_nan=False)  # infinities, subnormal numbers and negative zero included
EXAMPLE = make_example()


@given(
    coefficients=arrays(np.float64, (3, 2), elements=NUMBERS),
    projections=arrays(np.float64, (3, 14, 2), elements=NUMBERS),
    weights=arrays(np.float64, (3, 14), elements=st.floats(0, 1)),
    energies=st.lists(st.dictionaries(st.text(min_size=1, max_size=8), NUMBERS, max_size=3), min_size=3, max_size=3),
)
@settings(deadline=None, derandomize=True, max_examples=25)
def test_every_number_of_the_history_survives(coefficients, projections, weights, energies) -> None:
    result = EXAMPLE.reconstruction
    history = tuple(
        replace(step, coefficients=c, projections=p, weights=w, energies=e)
        for step, c, p, w, e in zip(
            result.diagnostics.history[:3], coefficients, projections, weights, energies, strict=True
        )
    )
    with tempfile.TemporaryDirectory() as folder, np.errstate(invalid="ignore", over="ignore"):
        path = Path(folder) / "car.rrd"
        record(path, changed(result, history=history), EXAMPLE.observation, EXAMPLE.camera)
        back = replay.read(path)
    for a, b in zip(back.history, history, strict=True):
        for name in ("camera_T_object", "coefficients", "keypoints", "projections", "weights"):
            assert getattr(a, name).tobytes() == getattr(b, name).tobytes()
        assert list(a.energies) == list(b.energies)
        assert [struct.pack("d", e) for e in a.energies.values()] == [struct.pack("d", e) for e in b.energies.values()]
    assert np.array_equal(back.scalars["coefficients"].values, coefficients)
