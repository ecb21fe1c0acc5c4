"""Training, annotation, evaluation and the paper's tables for fgrecon, and their commands."""
