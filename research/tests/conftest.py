"""The fixtures of fgrecon's own tests."""

from tests.conftest import content, data, scene, start

__all__ = ["content", "data", "scene", "start"]
