"""Localizer: events in, poses out, by the odometry that the configuration names."""

from wheelsight.localizer.apart import LocalizerApart
from wheelsight.localizer.beside import LocalizerBeside
from wheelsight.localizer.by_places import Places, load_places
from wheelsight.localizer.choice import Choice, Sensors, choose_odometry
from wheelsight.localizer.in_step import LocalizerInStep
from wheelsight.localizer.localizer import Localizer

__all__ = [
    "Choice",
    "Localizer",
    "LocalizerApart",
    "LocalizerBeside",
    "LocalizerInStep",
    "Places",
    "Sensors",
    "choose_odometry",
    "load_places",
]
