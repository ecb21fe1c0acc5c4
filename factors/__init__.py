"""GTSAM factors for the pose and shape of vehicles; depends on gtsam and numpy alone."""
