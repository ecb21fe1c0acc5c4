"""Evaluation of fgrecon and other methods on data with known poses.

`metrics` are pure functions, `tracks` reads data, `methods` is the one registry of what is compared, `run` scores
methods on data, and `report` turns scores into tables and documents.
"""
