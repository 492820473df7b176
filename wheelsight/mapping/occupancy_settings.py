"""OccupancySettings: what can be set about occupancy maps, with the reasons for the defaults."""

from __future__ import annotations

from typing import Self

from pydantic import model_validator

from wheelsight.settings import CHOSEN, Settings, conflict, setting

_OCTOMAP = "Hornung et al. 2013 (OctoMap), the defaults"
_MAP_SAVER = "what Nav2's map_saver writes"


class OccupancySettings(Settings):
    """The occupancy map of a map folder; see docs/occupancy.md."""

    resolution_m: float = setting(0.05, "side of a cell, metres", "what Nav2's maps have", ge=0.01, le=1)
    floor_m: float = setting(
        0.05,
        "what is seen higher is an obstacle, and what is so far below is no floor, metres: casters climb less",
        CHOSEN,
        gt=0,
        le=1,
    )
    drop_m: float = setting(
        0.1,
        "where a ray goes on so far below the floor, metres, the floor is missing: half of a stair's step, and more "
        "than a Kinect's floor is rough by",
        CHOSEN,
        gt=0,
        le=1,
    )
    tilt_rad: float = setting(
        0.015,
        "added to both for each metre of distance: the mount is known and the base stands level to about a degree",
        CHOSEN,
        ge=0,
        le=0.2,
    )
    height_m: float = setting(
        1.4, "up to where things are in the robot's way, metres", "a person who sits in a wheelchair", gt=0, le=5
    )
    overhang_m: float = setting(
        2.0,
        "up to where things above the robot are told as overhang, metres; beyond is the ceiling",
        CHOSEN,
        gt=0,
        le=10,
    )
    layer_m: float = setting(
        0.1,
        "height of a layer, metres: what is seen through at one height says nothing about the others, as the floor "
        "below a table does not about its top",
        "a simulated room: docs/decisions/0060",
        gt=0,
        le=10,
    )
    far_m: float = setting(
        5.0,
        "nothing farther is used, metres along the floor: a Kinect's depth errs by 3.6 cm there, nearly a cell",
        "reckoned",
        gt=0,
        le=30,
    )
    columns: int = setting(
        80, "of a keyframe's depth that are used, and rows as densely", "reckoned: a cell at 4 m", ge=8, le=1024
    )
    bridged_m: float = setting(
        0.15,
        "what neighbouring rays meet at one height and so near, metres, is one thing: no robot fits between",
        CHOSEN,
        ge=0,
        le=1,
    )
    hidden_m: float = setting(
        0.8,
        "how far behind what is seen its inside may be, metres: of a shelf at the camera's height its front alone is "
        "seen, and the floor below; as deep as tables are",
        "a simulated room: docs/decisions/0060",
        ge=0,
        le=10,
    )
    margin_sigmas: float = setting(
        3.0,
        "standard deviations of depth before what a ray ends at, and a cell, in which it frees nothing",
        CHOSEN,
        ge=0,
        le=100,
    )
    stood_m: float = setting(
        0.25, "radius about the base within which there is floor and nothing else: it stands there", CHOSEN, ge=0, le=2
    )
    hit: float = setting(
        0.7, "probability that a layer is occupied in which a keyframe sees something", _OCTOMAP, gt=0.5, lt=1
    )
    passed: float = setting(0.4, "likewise, through which it sees", _OCTOMAP, gt=0, lt=0.5)
    least: float = setting(
        0.12, "no probability falls below: what was free may come to be taken", _OCTOMAP, gt=0, lt=0.5
    )
    most: float = setting(0.97, "likewise, rises above", _OCTOMAP, gt=0.5, lt=1)
    occupied: float = setting(
        0.65, "probability from which on a cell is occupied; a drop-off is as surely none", _MAP_SAVER, ge=0.5, lt=1
    )
    most_cells: int = setting(
        6_000_000,
        "bound on memory, 16 bytes a cell: 150 × 100 m in cells of 0.05 m",
        "reckoned",
        ge=10_000,
        le=100_000_000,
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        if not self.floor_m < self.height_m < self.overhang_m:
            raise conflict("height_m", "is not between floor_m and overhang_m", "floor_m < height_m < overhang_m")
        return self

    @property
    def layers(self) -> int:
        """How many there are between the floor and the robot's height; the last may be lower."""
        return max(1, -int(-(self.height_m - self.floor_m) // self.layer_m))
