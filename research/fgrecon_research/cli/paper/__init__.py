"""Commands that make the paper's tables."""
