"""A shape prior made ready for solving."""
