"""Labels, samples and rounds that train the keypoint networks."""
