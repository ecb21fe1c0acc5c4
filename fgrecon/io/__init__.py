"""Every reader and writer: keypoint files, boxes, calibrations, labels, images, priors, results."""
