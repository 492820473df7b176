"""`SurfelSettings` configures surfel maps; `OccupancySettings` configures occupancy maps."""

from __future__ import annotations

from typing import Self

from pydantic import model_validator

from wheelsight.core.settings import CHOSEN, ON_SIMULATOR, Settings, conflict, setting

# SurfelSettings: what can be set about the surfel map, with the reasons for the defaults.


_FROM_0026 = f"{ON_SIMULATOR}: docs/decisions/0026"
_FROM_0037 = f"{ON_SIMULATOR}: docs/decisions/0037"


class SurfelSettings(Settings):
    """Settings of the surfel map; unknown names are refused."""

    stable_confidence: float = setting(10.0, "how many frames make a surfel stable", CHOSEN, gt=0, le=1e6)
    most_confidence: float = setting(
        100.0, "beyond, more frames change nothing: what is seen for long can still change", CHOSEN, gt=0, le=1e6
    )
    gone_confidence: float = setting(
        0.4, "a surfel before free space loses half of its confidence a frame, and is gone below", CHOSEN, gt=0, le=1e6
    )
    color_frames: float = setting(
        4.0,
        "frames over which colour is averaged: lamps and lenses shade a spot differently from each place, and what a "
        "far-off view showed would draw tracking back to there",
        _FROM_0037,
        ge=0,
        le=1e6,
    )
    most_readings: float = setting(
        50.0,
        "readings that count for a position, at most: it is never better known than poses are",
        CHOSEN,
        gt=0,
        le=1e6,
    )
    unstable_s: float = setting(3.0, "a surfel not stable so long after it was first seen goes", CHOSEN, gt=0, le=1e6)
    unseen_s: float = setting(1.0, "a surfel not stable goes sooner if not seen for so long", CHOSEN, gt=0, le=1e6)
    active_s: float = setting(
        60.0, "surfels not seen for longer are kept, but not tracked against", CHOSEN, gt=0, le=1e9
    )
    fused_way_m: float = setting(
        0.04, "frames nearer to the last one fused are left out, a turn by a radian as 1.5 m", CHOSEN, ge=0, le=100
    )
    fused_after_s: float = setting(
        0.1, "a frame so long after the last one fused is fused anyway", CHOSEN, gt=0, le=3600
    )
    colored_every: int = setting(
        3,
        "of so many fused frames one gives colour, which is only looked at; bringing it takes time",
        CHOSEN,
        gt=0,
        le=100,
    )
    merged_every: int = setting(
        3,
        "duplicates are looked for in one of so many fused frames: those of a few can be merged at once",
        CHOSEN,
        gt=0,
        le=100,
    )
    far_m: float = setting(
        6.0, "no surfel is predicted beyond; they are laid laid_sigmas farther", _FROM_0026, gt=0, le=40
    )
    laid_sigmas: float = setting(
        12.0,
        "standard deviations of depth: where laying ends, readings that err towards the camera lay surfels, and "
        "others are to mend that before they are shown",
        _FROM_0026,
        ge=0,
        le=100,
    )
    averaged_sigmas: float = setting(
        6.0,
        "standard deviations of depth that surfels are averaged farther than they are laid: else of a wall there only "
        "the readings that err towards the camera would count",
        _FROM_0026,
        ge=0,
        le=100,
    )
    radial_sigma: float = setting(
        0.6,
        "of a reading's weight over its distance from the image's centre, 1 at the farthest corner",
        "Keller et al. 2013, 4.2",
        gt=0,
        le=100,
    )
    vague_m: float = setting(
        0.035,
        "unstable surfels less surely placed are not predicted: a far wall's depth errs as one",
        _FROM_0026,
        gt=0,
        le=10,
    )
    gate_sigmas: float = setting(3.0, "distance along the normal at which readings still agree", CHOSEN, gt=0, le=100)
    gate_m: float = setting(0.01, "added to it: poses err too", CHOSEN, ge=0, le=10)
    max_angle_deg: float = setting(40.0, "between normals that agree", CHOSEN, gt=0, lt=90)
    max_slant_deg: float = setting(84.5, "surfaces seen at a sharper angle are not fused", _FROM_0026, gt=0, lt=90)
    least_cosine: float = setting(
        0.2,
        "of the angle at which a plane is seen, by which the depth's error counts along its normal",
        CHOSEN,
        gt=0,
        le=1,
    )
    disk_cosine: float = setting(
        0.35,
        "likewise, by which a disk is larger than its pixel: one that is grazed would reach far",
        CHOSEN,
        gt=0,
        le=1,
    )
    fine_enough: float = setting(
        1.5, "a disk so many times as large as a reading's is too coarse to stand for it", CHOSEN, ge=1, le=100
    )
    gap_m: float = setting(0.02, "so near a stable surfel's middle, its disk is not filled in", CHOSEN, ge=0, le=10)
    free_m: float = setting(
        0.05, "a surfel so far in front of what is measured, and free_sigmas, is gone", CHOSEN, gt=0, le=10
    )
    free_sigmas: float = setting(4.0, "standard deviations of depth, of that", CHOSEN, ge=0, le=100)
    drift_m: float = setting(0.1, "added to it for surfels outside the active window", CHOSEN, ge=0, le=100)
    blend: float = setting(
        0.012, "disks no farther apart, a metre of depth, are shown as one surface, and by", CHOSEN, ge=0, le=1
    )
    blend_m: float = setting(0.006, "more, metres, at any depth", CHOSEN, ge=0, le=1)
    smallest_px: float = setting(
        0.75,
        "radius of a disk that is shown, at least: pixels would fall between disks that were seen from nearer",
        CHOSEN,
        gt=0,
        le=100,
    )
    largest_px: float = setting(24.0, "likewise at most, for speed", CHOSEN, gt=0, le=1000)
    shown_cosine: float = setting(
        0.05, "of the angle at which a disk is seen, from which on it is shown", CHOSEN, gt=0, le=1
    )
    max_surfels: int = setting(
        3_000_000,
        "bound on those in memory, about 72 bytes each; others rest on the disk",
        "reckoned",
        ge=1024,
        le=6_000_000,
    )
    least_room: float = setting(
        0.1, "where less than this share of max_surfels is free, far surfels go to the disk", CHOSEN, gt=0, le=0.5
    )
    room_made: float = setting(0.3, "so large a share is free then", CHOSEN, gt=0, le=0.9)
    rests_beyond: float = setting(
        2.5,
        "those of keyframes that many times far_m from the camera may rest: from twice on, neither sees the other's",
        "reckoned",
        ge=2,
        le=100,
    )
    resting_folder: str | None = setting(
        None, "in which they rest; none for the system's folder of temporary files", CHOSEN
    )
    block_m: float = setting(0.5, "edge of the blocks by which surfels in view are found", CHOSEN, ge=0.05, le=10)
    threads: int = setting(2, "that share a frame's rows", "two cores, for which wheelsight is made", gt=0, le=64)


# OccupancySettings: what can be set about occupancy maps, with the reasons for the defaults.


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
