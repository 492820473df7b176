"""SurfelSettings: what can be set about the surfel map, with the reasons for the defaults."""

from __future__ import annotations

from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt

from wheelsight.settings import Settings


class SurfelSettings(Settings):
    """Settings of the surfel map; unknown names are refused."""

    stable_confidence: PositiveFloat = Field(default=10.0, le=1e6, description="how many frames make a surfel stable")
    unstable_s: PositiveFloat = Field(
        default=3.0, le=1e6, description="a surfel not stable so long after it was first seen goes"
    )
    unseen_s: PositiveFloat = Field(
        default=1.0, le=1e6, description="a surfel not stable goes sooner if not seen for so long"
    )
    active_s: PositiveFloat = Field(
        default=60.0, le=1e9, description="surfels not seen for longer are kept, but not tracked against"
    )
    fused_way_m: NonNegativeFloat = Field(
        default=0.04,
        le=100,
        description="frames nearer to the last one fused are left out, a turn by a radian as 1.5 m",
    )
    fused_after_s: PositiveFloat = Field(
        default=0.1, le=3600, description="a frame so long after the last one fused is fused anyway"
    )
    colored_every: PositiveInt = Field(
        default=3,
        le=100,
        description="of so many fused frames one gives colour, which is only looked at; bringing it takes time",
    )
    beyond_share: NonNegativeFloat = Field(
        default=0.05,
        le=1,
        description="where more of a frame's depths lie beyond far_m, keyframes show more than the map does",
    )
    merged_every: PositiveInt = Field(
        default=3,
        le=100,
        description="duplicates are looked for in one of so many fused frames: those of a few can be merged at once",
    )
    far_m: PositiveFloat = Field(
        default=6.0, le=40, description="no surfel is predicted beyond; they are laid laid_sigmas farther"
    )
    laid_sigmas: NonNegativeFloat = Field(
        default=12.0,
        le=100,
        description="standard deviations of depth: where laying ends, readings that err towards the camera lay "
        "surfels, and others are to mend that before they are shown",
    )
    radial_sigma: PositiveFloat = Field(
        default=0.6,
        le=100,
        description="of a reading's weight over its distance from the image's centre, 1 at the farthest corner "
        "(Keller et al. 2013, 4.2)",
    )
    vague_m: PositiveFloat = Field(
        default=0.035,
        le=10,
        description="unstable surfels less surely placed are not predicted: a far wall's depth errs as one",
    )
    gate_sigmas: PositiveFloat = Field(
        default=3.0, le=100, description="distance along the normal at which readings still agree"
    )
    gate_m: NonNegativeFloat = Field(default=0.01, le=10, description="added to it: poses err too")
    max_angle_deg: float = Field(default=40.0, gt=0, lt=90, description="between normals that agree")
    max_slant_deg: float = Field(
        default=84.5, gt=0, lt=90, description="surfaces seen at a sharper angle are not fused"
    )
    gap_m: NonNegativeFloat = Field(
        default=0.02, le=10, description="so near a stable surfel's middle, its disk is not filled in"
    )
    free_m: PositiveFloat = Field(
        default=0.05, le=10, description="a surfel so far in front of what is measured, and 4 σ, is gone"
    )
    drift_m: NonNegativeFloat = Field(
        default=0.1, le=100, description="added to it for surfels outside the active window"
    )
    max_surfels: PositiveInt = Field(
        default=3_000_000, ge=1024, le=6_000_000, description="bound on memory, about 72 bytes a surfel"
    )
    block_m: PositiveFloat = Field(
        default=0.5, ge=0.05, le=10, description="edge of the blocks by which surfels in view are found"
    )
    threads: PositiveInt = Field(default=2, le=64, description="that share a frame's rows")
