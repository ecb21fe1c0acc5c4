"""Cars in a photograph: their 2D boxes, where neither a person nor another program gives them."""

from fgrecon.core.renamed import renamed
from fgrecon.perception.vehicles.detect import NanodetVehicleDetector, Vehicles, YoloVehicleDetector

__all__ = ["NanodetVehicleDetector", "Vehicles", "YoloVehicleDetector"]

__getattr__ = renamed(__name__, {"VehicleDetector": "NanodetVehicleDetector"})
