"""Shape-aware adjustment: the factor graph over pose, lambda and planes."""
