"""Every reader and writer: keypoint files, boxes, calibrations, labels, images, priors, results.

What cannot be read or written, is missing, malformed or none of its kind is refused by an `InvalidInputError` that
names it: the file with its field, line or record, or a bag's topic. Docstrings tell what is refused beside that. Of
arguments `where` is what an error begins with, `field` or `name` what it names, `fix` what it says to give instead,
`data` the content of a file, and `category` that whose keypoints are wanted.
"""
