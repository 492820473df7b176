"""`wheelsight map zone`: what people say of parts of a map's floor."""

from __future__ import annotations

from wheelsight.cli import _map_options as options
from wheelsight.cli import _maps as work
from wheelsight.cli._zone_words import AskedZone


def zone(
    source: options.MapPath,
    corners: options.Corners = None,
    keep_out: options.KeepOut = False,
    speed: options.Speed = None,
    wipe: options.Wipe = False,
    area: options.AreaName = None,
    areas: options.AreasFile = None,
    forget: options.Forget = None,
) -> None:
    """Say where nobody drives, where all drive slowly, what is gone, or what an area is called; or list all that.

    Zones and areas are in the map's edits.json. Each hangs on the nearest keyframe and moves with it, as where a loop
    closes; rebuild, merge and prune carry them over. wheelsight map export MAP --picture plan.png shows the
    map, and says from where to where it reaches.

    [bold]Examples[/bold]

    wheelsight map zone home --keep-out 2,-1 3,-1 3,0.5

    wheelsight map zone home --speed 0.3 -1,2 4,3

    wheelsight map zone home --wipe 5,0 5.4,0.4

    wheelsight map zone home --area kitchen 4,-3 7,-3 7,0 4,0

    wheelsight map zone home

    wheelsight map zone home --forget 2
    """
    work.zone(source, AskedZone(tuple(corners or ()), keep_out, speed, wipe, area, areas, forget))
