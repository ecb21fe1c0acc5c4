"""Files of other sensors than the camera: points of LiDARs, depth maps, and where those sensors are."""
