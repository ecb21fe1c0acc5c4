"""The picture and recording of a prior: what is drawn, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.catalogue import load_prior
from fgrecon.viz.prior_picture import prior_picture
from fgrecon.viz.prior_recording import record_prior


def test_one_row_for_the_mean_and_one_per_mode():
    prior = load_prior("car14")
    figure = prior_picture(prior, 2)
    assert len(figure.axes) == 3 * 3
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert titles[0].startswith("mean")
    assert titles[6].startswith("mode 2")
    assert len(prior_picture(prior.truncated(0)).axes) == 3


def test_the_extremes_are_two_standard_deviations_apart_from_the_mean():
    prior = load_prior("car14")
    figure = prior_picture(prior, 1)
    side = figure.axes[3]  # the first mode from the right: x across, height up
    ends = side.collections[-1].get_segments()
    expected = prior.mean + 2 * np.array([-1, 1])[:, None, None] * prior.basis[0]
    np.testing.assert_allclose(np.array(ends)[:, :, 0], expected[:, :, 0].T)
    np.testing.assert_allclose(np.array(ends)[:, :, 1], -expected[:, :, 1].T)


def test_too_many_modes_and_an_absent_folder_are_refused(tmp_path):
    prior = load_prior("car14")
    with pytest.raises(InvalidInputError, match="modes"):
        prior_picture(prior, 6)
    with pytest.raises(InvalidInputError, match="folder"):
        record_prior(tmp_path / "absent" / "a.rrd", prior.truncated(1))
