"""Localizer: events in, poses out, by the odometry that the configuration names."""

from wheelsight.localizer.by_places import Places, load_places
from wheelsight.localizer.localizer import Localizer

__all__ = ["Localizer", "Places", "load_places"]
