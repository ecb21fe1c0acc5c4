"""Cars in a photograph: their 2D boxes, where neither a person nor another program gives them."""

from fgrecon.core.renamed import renamed
from fgrecon.perception.vehicles.detect import Vehicles, YoloVehicleDetector

__all__ = ["Vehicles", "YoloVehicleDetector"]

__getattr__ = renamed(__name__, {"VehicleDetector": "YoloVehicleDetector"})
