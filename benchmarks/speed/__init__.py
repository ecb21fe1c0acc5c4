"""How fast the solver is, and that its results are the same: one command, `python -m benchmarks.speed`."""
