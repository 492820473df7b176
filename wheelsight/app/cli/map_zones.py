"""The tasks of `wheelsight map zone`, and the parser of its options."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from wheelsight.app.cli.map_contents import MapPath
from wheelsight.app.cli.options import option_field
from wheelsight.core.errors import ConfigError, MapError

if TYPE_CHECKING:
    from wheelsight.core.geometry import FloatArray
    from wheelsight.mapping import MapEdit, MapEdits
    from wheelsight.slam.maps import MapFolder


def change_zones(asked: ZoneOptions) -> None:
    """Add zones or areas, or remove one. Raises ConfigError, MapError, AreaError, OutputError."""
    from wheelsight.app.cli.compiling import compile_missing
    from wheelsight.app.cli.console import print_warning
    from wheelsight.app.cli.progress import FrameProgress
    from wheelsight.mapping import EditKind, MapEdits
    from wheelsight.slam.maps import MapFolder, find_map, save_occupancy
    from wheelsight.slam.maps.contents import current_edits
    from wheelsight.slam.maps.folder import OCCUPANCY_FILE

    drawn = drawn_by(asked)
    folder = MapFolder.open(find_map(asked.source), read_only=False)
    try:
        known = current_edits(folder)
        if asked.forget is None:
            changed = _added(folder, known, drawn)
        elif 0 < asked.forget <= len(known):
            changed = [known.edits[asked.forget - 1]]
            folder.save_edits(MapEdits(tuple(edit for edit in known.edits if edit is not changed[0])))
            typer.echo(f"forgotten: {_what(changed[0])}")
        else:
            fix = f"1 to {len(known)}; wheelsight map zone MAP lists them" if len(known) else "the map has no zones"
            raise ConfigError(f"--forget is {asked.forget}", fix=fix)
        # An exported occupancy map changes with it: other programs must know a new zone, too.
        path = folder.path / OCCUPANCY_FILE
        if path.is_file() and {edit.kind for edit in changed} & {EditKind.KEEP_OUT, EditKind.WIPED}:
            compile_missing(["dense"])
            try:
                with FrameProgress("occupancy", None, unit="keyframes") as progress:
                    save_occupancy(folder, progress.reach)
            except MapError as error:
                print_warning(f"{path} is as it was, without this change: {error}")
    finally:
        folder.close()


def _added(folder: MapFolder, known: MapEdits, drawn: Sequence[MapEdit]) -> Sequence[MapEdit]:
    """Attach each edit to the nearest keyframe, save it, and print it."""
    from wheelsight.slam.maps import in_largest_piece

    # A keyframe of unknown position must not carry a zone.
    sure, poses = in_largest_piece(folder).nonzero()[0], folder.named_poses().names
    hung = [edit.attached_to_nearest(folder.store.T_map_keyframe, sure) for edit in drawn]
    for edit in hung:
        known = known.with_edit(edit)
    folder.save_edits(known)
    for number, edit in enumerate(hung, start=len(known) - len(hung) + 1):
        on = "no keyframe" if edit.keyframe is None else f"keyframe {edit.keyframe}"
        import shapely

        size_m2 = float(shapely.Polygon(edit.polygon).area)
        typer.echo(f"{number}: {_what(edit)}: {size_m2:.2f} m², moves with {on}")
        _warn_beyond_seen_floor(_what(edit), edit.polygon, folder.store.T_map_keyframe[sure])
        if edit.name in poses:
            from wheelsight.app.cli.console import print_warning

            print_warning(
                f"a place is called {edit.name}, too, and is where wheelsight drive --to goes "
                f"(wheelsight map name MAP '{edit.name}' --remove leaves the area alone)"
            )
    return hung


def _warn_beyond_seen_floor(what: str, polygon: FloatArray, T_map_keyframe: FloatArray) -> None:
    """Warn of a polygon beyond the seen floor: probably mistyped, or in another frame."""
    import shapely

    from wheelsight.app.cli.console import print_warning
    from wheelsight.mapping import OccupancySettings

    far_m = OccupancySettings().far_m
    at = shapely.points(T_map_keyframe[:, :2, 3])
    off_m = float(shapely.distance(shapely.Polygon(polygon), at).min(initial=math.inf))
    if far_m < off_m < math.inf:
        print_warning(
            f"{what}: it lies wholly beyond what the map shows, {off_m:.1f} m from the nearest keyframe, which shows "
            f"the floor to {far_m:g} m (wheelsight map export MAP --picture plan.png shows the map)"
        )


def print_zones(folder: MapFolder) -> None:
    """Print all edits of a map with their numbers and current polygons. Raises MapError."""
    from wheelsight.app.cli.console import console, facts_table
    from wheelsight.slam.maps.contents import current_edits

    known = current_edits(folder)
    if not len(known):
        typer.echo("the map has no zones: wheelsight map zone MAP --keep-out X,Y X,Y X,Y")
        return
    table = folder.store.T_map_keyframe
    facts = []
    for number, edit in enumerate(known.edits, 1):
        # As one types it. Adding 0 makes a zero of a negative one.
        corners = " ".join(f"{x:.2f},{y:.2f}" for x, y in (edit.polygon_now(table).round(2) + 0.0).tolist())
        facts.append((str(number), f"{_what(edit)}: {corners}"))
    console().print(facts_table("zones and areas", facts))


def _what(edit: MapEdit) -> str:
    """Description of an edit, such as "speed zone, at most 0.3 m/s"."""
    from wheelsight.mapping import EditKind

    if edit.limit_m_s is not None:
        return f"speed zone, at most {edit.limit_m_s:g} m/s"
    if edit.name is not None:
        return f"area {edit.name}"
    names = {EditKind.KEEP_OUT: "keep-out zone", EditKind.WIPED: "wiped place", EditKind.FLOOR: "declared floor"}
    return names[edit.kind]


_ZONES = "What is there"
_WHICH = "--keep-out, --speed M_S, --wipe, --floor or --area NAME"
_FORM = "X,Y in metres in the map, such as 2,-1 3,-1 3,0.5; two are opposite corners of a rectangle"


@dataclass(frozen=True, slots=True)
class ZoneOptions:
    """Options of `wheelsight map zone`: one kind of zone or area with its corners; without options, a list."""

    source: MapPath
    corners: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="X,Y...",
            help="Corners in the order of the outline, metres in the map; two are opposite corners of a rectangle.",
            show_default=False,
        ),
    ] = None
    keep_out: bool = option_field("Robots do not drive there.", default=False, panel=_ZONES)
    speed: float | None = option_field("The speed limit there, in metres a second.", "M_S", False, _ZONES)
    wipe: bool = option_field("Obstacles that the map has there are gone: free.", default=False, panel=_ZONES)
    floor: bool = option_field(
        "It is floor that carries the robot, such as a black carpet, though the camera measures none.",
        default=False,
        panel=_ZONES,
    )
    area: str | None = option_field("It is called so, for wheelsight drive --to NAME.", "NAME", False, _ZONES)
    areas: Path | None = option_field(
        "All areas of an areas.yaml, whose corners must be in this map's frame; that of a simulated world is in "
        "the building's.",
        "FILE",
        False,
        _ZONES,
    )
    forget: int | None = option_field("Forget the one of this number in the list.", "NUMBER", False, _ZONES)

    @property
    def option(self) -> str | None:
        """The first option that was given."""
        return next(iter(self._options()), None)

    def _options(self) -> list[str]:
        flags = (self.keep_out or None, self.wipe or None, self.floor or None)
        values = (*flags, self.speed, self.area, self.areas, self.forget)
        names = ("--keep-out", "--wipe", "--floor", "--speed", "--area", "--areas", "--forget")
        return [name for name, value in zip(names, values, strict=True) if value is not None]

    def check(self) -> None:
        """Check the options. Raises ConfigError for invalid combinations."""
        for word in self.corners or ():
            if word.startswith("-") and not word[1:2].isdigit() and word[1:2] != ".":
                raise ConfigError(f"there is no option {word}", fix=f"{_WHICH}; --areas FILE or --forget NUMBER")
        options = self._options()
        if len(options) > 1:
            raise ConfigError(f"{options[0]} and {options[1]} are given at once", fix="one after another")
        if not options and self.corners:
            raise ConfigError("what is in these corners is not said", fix=_WHICH)
        if self.option in ("--areas", "--forget") and self.corners:
            raise ConfigError(f"{self.option} has no corners", fix="leave them out")
        if self.speed is not None and not 0 < self.speed < math.inf:
            raise ConfigError(f"--speed is {self.speed:g}", fix="metres a second, over 0, such as 0.3; or --keep-out")


def drawn_by(asked: ZoneOptions) -> Sequence[MapEdit]:
    """The edits of the options, not attached to keyframes. Raises ConfigError, MapError, AreaError."""
    import numpy as np

    from wheelsight.core.areas import load_areas
    from wheelsight.mapping import EditKind, MapEdit

    if asked.areas is not None:
        return [MapEdit(EditKind.AREA, area.polygon, name=area.name) for area in load_areas(asked.areas)]
    if asked.forget is not None:
        return []
    # (N, 2) corners of words such as "2,-1" or "2,-1 3,-1 3,0.5"
    option, corners = asked.option or "", []
    for text in (text for word in asked.corners or () for text in word.split()):
        try:
            x_m, y_m = map(float, text.split(","))
        except ValueError:
            x_m = y_m = math.nan
        if not math.isfinite(x_m) or not math.isfinite(y_m):
            raise ConfigError(f"{text!r} is no corner", fix=_FORM)
        corners.append((x_m, y_m))
    if len(corners) < 2:
        raise ConfigError(f"{option} has {'one corner' if corners else 'no corners'}", fix=_FORM)
    if len(corners) == 2:
        (x, y), (far_x, far_y) = corners
        corners = [(x, y), (far_x, y), (far_x, far_y), (x, far_y)]
    polygon = np.array(corners)
    if asked.speed is not None:
        return [MapEdit(EditKind.SPEED, polygon, limit_m_s=asked.speed)]
    if asked.area is not None:
        return [MapEdit(EditKind.AREA, polygon, name=asked.area)]
    kind = EditKind.KEEP_OUT if asked.keep_out else EditKind.FLOOR if asked.floor else EditKind.WIPED
    return [MapEdit(kind, polygon)]
