"""Cars in a photograph: their 2D boxes, where neither a person nor another program gives them.

`detect` is the network at work; `darknet` makes the file that it reads from the one that its authors published.
"""

from fgrecon.perception.vehicles.detect import VehicleDetector, Vehicles

__all__ = ["VehicleDetector", "Vehicles"]
