"""The made-up result that every test of drawing shares."""

from __future__ import annotations

import pytest

from tests.viz.made_up import Example, make_example


@pytest.fixture(scope="session")
def example() -> Example:
    """The made-up result; nothing changes it."""
    return make_example()
