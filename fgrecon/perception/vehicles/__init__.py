"""Cars in a photograph: their 2D boxes, where neither a person nor another program gives them."""

from fgrecon.perception.vehicles.detect import NanodetVehicleDetector, Vehicles, YoloVehicleDetector

__all__ = ["NanodetVehicleDetector", "Vehicles", "YoloVehicleDetector"]
