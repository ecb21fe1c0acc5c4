"""Shape priors prepared for solving."""
