"""Evaluation: metrics, data, baselines, tables."""
