"""Fits what results say of themselves to a detector, from labelled drives: what `fgrecon calibrate` does."""
