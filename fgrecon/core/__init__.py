"""Inputs, options and results as frozen data, with their checks and errors. No I/O."""
