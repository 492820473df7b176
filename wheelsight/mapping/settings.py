"""`SurfelSettings` configures surfel maps; `OccupancySettings` configures occupancy maps."""

from __future__ import annotations

from typing import Self

from pydantic import model_validator

from wheelsight.core.settings import CHOSEN, ON_SIMULATOR, Settings, conflict, setting

_FROM_0026 = f"{ON_SIMULATOR}: docs/decisions/0026"
_FROM_0037 = f"{ON_SIMULATOR}: docs/decisions/0037"


class SurfelSettings(Settings):
    """Settings of the surfel map; unknown names are rejected."""

    stable_confidence: float = setting(10.0, "number of frames that make a surfel stable", CHOSEN, gt=0, le=1e6)
    most_confidence: float = setting(
        100.0, "largest confidence, frames: a surface seen for long can still change", CHOSEN, gt=0, le=1e6
    )
    gone_confidence: float = setting(
        0.4,
        "a surfel in free space loses half of its confidence per frame, and is removed below this",
        CHOSEN,
        gt=0,
        le=1e6,
    )
    color_frames: float = setting(
        4.0,
        "frames over which colour is averaged: lamps and lenses shade a point differently from each "
        "viewpoint, and a distant view's colour would bias tracking",
        _FROM_0037,
        ge=0,
        le=1e6,
    )
    most_readings: float = setting(
        50.0,
        "largest number of readings that count for a position: it is never better known than poses are",
        CHOSEN,
        gt=0,
        le=1e6,
    )
    unstable_s: float = setting(
        3.0, "time after its first observation at which an unstable surfel is removed", CHOSEN, gt=0, le=1e6
    )
    unseen_s: float = setting(
        1.0, "time without observation after which an unstable surfel is removed", CHOSEN, gt=0, le=1e6
    )
    active_s: float = setting(
        60.0, "surfels not seen for longer are kept, but not used in tracking", CHOSEN, gt=0, le=1e9
    )
    fused_way_m: float = setting(
        0.04,
        "frames nearer to the last fused one are skipped; a turn by a radian counts as 1.5 m",
        CHOSEN,
        ge=0,
        le=100,
    )
    fused_after_s: float = setting(
        0.1, "time after the last fused frame at which a frame is always fused", CHOSEN, gt=0, le=3600
    )
    colored_every: int = setting(
        3,
        "one fused frame in this many gives colour, which is for display only and takes time to load",
        CHOSEN,
        gt=0,
        le=100,
    )
    merged_every: int = setting(
        3,
        "duplicates are merged in one fused frame in this many: those of a few frames can be merged at once",
        CHOSEN,
        gt=0,
        le=100,
    )
    far_m: float = setting(
        6.0, "largest distance of predicted surfels; they are added laid_sigmas farther", _FROM_0026, gt=0, le=40
    )
    laid_sigmas: float = setting(
        12.0,
        "standard deviations of depth: at the end of this range, readings that err towards the camera add "
        "surfels, and others correct them before they are predicted",
        _FROM_0026,
        ge=0,
        le=100,
    )
    averaged_sigmas: float = setting(
        6.0,
        "standard deviations of depth by which surfels are averaged farther than they are added: otherwise "
        "only readings of a wall there that err towards the camera would count",
        _FROM_0026,
        ge=0,
        le=100,
    )
    radial_sigma: float = setting(
        0.6,
        "standard deviation of a reading's weight over its distance from the image centre, 1 at the farthest corner",
        "Keller et al. 2013, 4.2",
        gt=0,
        le=100,
    )
    vague_m: float = setting(
        0.035,
        "unstable surfels with a larger standard deviation are not predicted: the depth errors of a far wall "
        "are correlated",
        _FROM_0026,
        gt=0,
        le=10,
    )
    gate_sigmas: float = setting(3.0, "largest distance of consistent readings along the normal", CHOSEN, gt=0, le=100)
    gate_m: float = setting(0.01, "added to it, for errors of poses", CHOSEN, ge=0, le=10)
    max_angle_deg: float = setting(40.0, "largest angle between consistent normals", CHOSEN, gt=0, lt=90)
    max_slant_deg: float = setting(84.5, "surfaces seen at a larger angle are not fused", _FROM_0026, gt=0, lt=90)
    least_cosine: float = setting(
        0.2,
        "least cosine of the viewing angle of a plane, by which the depth error is projected on its normal",
        CHOSEN,
        gt=0,
        le=1,
    )
    disk_cosine: float = setting(
        0.35,
        "least cosine of the viewing angle by which a disk is larger than its pixel: a grazed one would reach far",
        CHOSEN,
        gt=0,
        le=1,
    )
    fine_enough: float = setting(
        1.5, "a disk larger than a reading's by this factor is too coarse to cover it", CHOSEN, ge=1, le=100
    )
    gap_m: float = setting(0.02, "no disk is added this close to a stable surfel's centre", CHOSEN, ge=0, le=10)
    free_m: float = setting(
        0.05, "a surfel this far in front of a measurement, plus free_sigmas, is removed", CHOSEN, gt=0, le=10
    )
    free_sigmas: float = setting(4.0, "standard deviations of depth, added to free_m", CHOSEN, ge=0, le=100)
    drift_m: float = setting(0.1, "added to it for surfels outside the active window", CHOSEN, ge=0, le=100)
    blend: float = setting(
        0.012, "disks at most this far apart, per metre of depth, are shown as one surface, plus", CHOSEN, ge=0, le=1
    )
    blend_m: float = setting(0.006, "this distance, metres, at any depth", CHOSEN, ge=0, le=1)
    smallest_px: float = setting(
        0.75,
        "least radius of a shown disk: otherwise there would be gaps between disks that were seen from nearer",
        CHOSEN,
        gt=0,
        le=100,
    )
    largest_px: float = setting(24.0, "likewise, the largest radius, for speed", CHOSEN, gt=0, le=1000)
    shown_cosine: float = setting(
        0.05, "least cosine of the viewing angle at which a disk is shown", CHOSEN, gt=0, le=1
    )
    max_surfels: int = setting(
        3_000_000,
        "largest number of surfels in memory, about 72 bytes each; others are on disk",
        "estimated",
        ge=1024,
        le=6_000_000,
    )
    least_room: float = setting(
        0.1, "if a smaller share of max_surfels is free, distant surfels are moved to disk", CHOSEN, gt=0, le=0.5
    )
    room_made: float = setting(0.3, "share that is free afterwards", CHOSEN, gt=0, le=0.9)
    rests_beyond: float = setting(
        2.5,
        "surfels of keyframes farther from the camera, in multiples of far_m, may be on disk: from twice "
        "far_m on, neither view overlaps",
        "estimated",
        ge=2,
        le=100,
    )
    resting_folder: str | None = setting(
        None, "folder of surfels on disk; none for the system's folder of temporary files", CHOSEN
    )
    block_m: float = setting(0.5, "edge of the blocks that index surfels in view", CHOSEN, ge=0.05, le=10)
    threads: int = setting(
        2, "threads that share a frame's rows", "two cores, for which wheelsight is made", gt=0, le=64
    )


_OCTOMAP = "Hornung et al. 2013 (OctoMap), the defaults"
_MAP_SAVER = "what Nav2's map_saver writes"


class OccupancySettings(Settings):
    """Occupancy map of a map folder; see docs/occupancy.md."""

    resolution_m: float = setting(0.05, "side of a cell, metres", "what Nav2's maps have", ge=0.01, le=1)
    floor_m: float = setting(
        0.05,
        "points higher than this are obstacles, and points this far below are not the floor, metres: casters "
        "climb less",
        CHOSEN,
        gt=0,
        le=1,
    )
    drop_m: float = setting(
        0.1,
        "a ray that ends this far below the floor, metres, shows a drop-off: half of a stair's step, and more"
        " than the roughness of a floor seen by a Kinect",
        CHOSEN,
        gt=0,
        le=1,
    )
    tilt_rad: float = setting(
        0.015,
        "added to both for each metre of distance: the mount and the base are level to about a degree",
        CHOSEN,
        ge=0,
        le=0.2,
    )
    height_m: float = setting(
        1.4, "height up to which objects obstruct the robot, metres", "a person who sits in a wheelchair", gt=0, le=5
    )
    overhang_m: float = setting(
        2.0,
        "height up to which objects above the robot are overhangs, metres; higher ones are the ceiling",
        CHOSEN,
        gt=0,
        le=10,
    )
    layer_m: float = setting(
        0.1,
        "height of a layer, metres: free space at one height does not free the others, as the floor below a "
        "table does not free its top",
        "a simulated room: docs/decisions/0060",
        gt=0,
        le=10,
    )
    far_m: float = setting(
        5.0,
        "largest distance used, metres along the floor: a Kinect's depth error there is 3.6 cm, nearly a cell",
        "estimated",
        gt=0,
        le=30,
    )
    columns: int = setting(
        80,
        "number of a keyframe's depth columns that are used, with rows as dense",
        "estimated: a cell at 4 m",
        ge=8,
        le=1024,
    )
    bridged_m: float = setting(
        0.15,
        "neighbouring rays that hit at one height within this distance, metres, hit one object: no robot fits between",
        CHOSEN,
        ge=0,
        le=1,
    )
    hidden_m: float = setting(
        0.8,
        "depth of the unknown space behind a surface, metres: of a shelf at the camera's height, only the "
        "front and the floor below are visible; as deep as tables are",
        "a simulated room: docs/decisions/0060",
        ge=0,
        le=10,
    )
    margin_sigmas: float = setting(
        3.0,
        "standard deviations of depth, and a cell, before a ray's end in which it frees nothing",
        CHOSEN,
        ge=0,
        le=100,
    )
    stood_m: float = setting(
        0.25, "radius around the base within which the floor is free, since the base stands there", CHOSEN, ge=0, le=2
    )
    hit: float = setting(
        0.7, "probability that a layer is occupied in which a keyframe sees something", _OCTOMAP, gt=0.5, lt=1
    )
    passed: float = setting(0.4, "likewise, for a layer that it sees through", _OCTOMAP, gt=0, lt=0.5)
    least: float = setting(0.12, "least probability: free space may become occupied", _OCTOMAP, gt=0, lt=0.5)
    most: float = setting(0.97, "likewise, the largest", _OCTOMAP, gt=0.5, lt=1)
    occupied: float = setting(
        0.65, "least probability of an occupied cell; a drop-off is as certain", _MAP_SAVER, ge=0.5, lt=1
    )
    most_cells: int = setting(
        6_000_000,
        "limit of memory, 16 bytes per cell: 150 × 100 m in cells of 0.05 m",
        "estimated",
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
        """Number of layers between the floor and the robot's height; the last may be lower."""
        return max(1, -int(-(self.height_m - self.floor_m) // self.layer_m))
