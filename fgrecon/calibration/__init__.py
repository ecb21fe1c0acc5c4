"""Calibration of a detector's uncertainty on labelled drives, the work of `fgrecon calibrate`."""
