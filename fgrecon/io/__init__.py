"""Every reader and writer: keypoint files, boxes, calibrations, labels, images, priors, results.

What cannot be read or written, is missing, malformed or none of its kind is refused by an `InvalidInputError` that
names it: the file with its field, line or record, or a bag's topic. Docstrings tell what is refused beside that.
"""
