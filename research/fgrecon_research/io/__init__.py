"""Files of training and evaluation: annotated images, keypoint labels, KITTI's sets with every defect counted."""
