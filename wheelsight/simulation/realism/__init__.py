"""What a real robot's sensors do beside their noise, each part with its numbers and where they are from."""

from wheelsight.simulation.realism.carriage import Carriage, carriage_of
from wheelsight.simulation.realism.presets import Realism, RealismName, realism_names, realism_of, stream
from wheelsight.simulation.realism.unit import CameraUnit, unit_of

__all__ = [
    "CameraUnit",
    "Carriage",
    "Realism",
    "RealismName",
    "carriage_of",
    "realism_names",
    "realism_of",
    "stream",
    "unit_of",
]
