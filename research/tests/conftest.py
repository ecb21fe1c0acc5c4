"""The fixtures of fgrecon's own tests."""

from tests.cli.conftest import instance, weights, write
from tests.conftest import content, data, scene, start

__all__ = ["content", "data", "instance", "scene", "start", "weights", "write"]
