"""The tests on clusters are a job of their own: `pytest -m cluster tests/engines`."""

import pytest


def pytest_collection_modifyitems(config, items):
    if "cluster" in (config.option.markexpr or ""):
        return
    for item in items:
        if item.get_closest_marker("cluster"):
            item.add_marker(pytest.mark.skip(reason="a job of its own: pytest -m cluster tests/engines"))
