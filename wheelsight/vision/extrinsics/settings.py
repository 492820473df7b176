"""ExtrinsicsSettings: what can be set about finding where a camera sits, with the reasons for the defaults.

Real drives with a measured mount are too few to tell much: most of these numbers were chosen by reasoning.
"""

from __future__ import annotations

from typing import Annotated

from wheelsight.core.settings import Settings, bounds, setting

_DOES = "chosen; that it does was found on the simulator alone"


class AgreementSettings(Settings):
    """When the motions of wheels and camera agree, and what explains a disagreement."""

    piece_m: float = setting(
        0.06,
        "a piece of the drive is over when either has gone so far: a camera errs by a millimetre or two, and a "
        "robot of half a metre a second is reported after its first three frames",
        _DOES,
        gt=0,
        le=10,
    )
    piece_rad: float = setting(0.06, "or when either has turned so far", _DOES, gt=0, le=3)
    usual_m: float = setting(
        0.01, "wheels and camera differ by it in any piece, as clocks are milliseconds apart", _DOES, gt=0, le=1
    )
    usual_rad: float = setting(0.01, "likewise in turns", _DOES, gt=0, le=1)
    slips: float = setting(2.0, "tolerance of rotations, as a multiple of the calibration's slip", _DOES, ge=0, le=100)
    drift_rad_per_m: float = setting(
        0.04,
        "and what radii that are unequal by 2 % do in a metre, as filters allow for",
        "computed, of wheels 0.5 m apart",
        ge=0,
        le=1,
    )
    largest_factor: float = setting(
        100.0, "of sizes: a missing gear; beyond, only one sensor reports motion", _DOES, gt=1, le=1e6
    )
    disagrees: float = setting(
        0.03,
        "share of the squared motion that is left: a scale 20 % or a direction 10° off, which no data sheet, tape "
        "measure or protractor is",
        "computed from these",
        gt=0,
        le=1,
    )
    explained: float = setting(
        0.015, "share that an explanation leaves: half of it is explained well", _DOES, gt=0, le=1
    )
    same_scale: float = setting(
        0.15, "logarithm by which a floor's height may be off, by mount, tilt and what lies on it", _DOES, gt=0, le=3
    )
    least_turn_deg: float = setting(
        8.0, "of a mount that looks elsewhere; less is within what is called agreement", _DOES, gt=0, le=90
    )
    largest_tilt_deg: float = setting(
        10.0, "of a mount's up, from which on the floor would lie elsewhere too", _DOES, gt=0, le=90
    )


class FloorSettings(Settings):
    """Which plane is the floor, and when it is well determined."""

    farthest_m: float = setting(5.0, "largest depth; beyond, errors outweigh the information", _DOES, gt=0, le=100)
    least_height_m: float = setting(0.05, "of a camera over the floor", _DOES, gt=0, le=10)
    highest_m: float = setting(3.0, "likewise at most", _DOES, gt=0, le=100)
    bin_m: float = setting(0.04, "steps of heights in which points are counted", _DOES, gt=0, le=1)
    peak_share: float = setting(0.2, "of the most points at one height, which many points are", _DOES, gt=0, le=1)
    bands_m: tuple[Annotated[float, bounds(gt=0, le=10)], ...] = setting(
        (0.15, 0.10, 0.06, 0.04, 0.04), "about the plane, narrowed step by step", _DOES, min_length=1, max_length=100
    )
    robust_steps: int = setting(8, "of reweighting, after that", _DOES, gt=0, le=1000)
    outlier_chi2: float = setting(9.0, "three standard deviations off the plane", "computed: χ² of 1", gt=0, le=1e4)
    fewest_points: int = setting(40, "that show the plane in a view", _DOES, gt=0, le=10**6)
    fewest_views: int = setting(10, "that show it, and at least", _DOES, gt=0, le=10**6)
    fewest_share: float = setting(0.25, "of all views", _DOES, ge=0, le=1)
    below_m: float = setting(0.15, "under the plane lies what is no noise of it", _DOES, gt=0, le=10)
    most_below: float = setting(0.1, "of the points on it; with more below it is a table", _DOES, ge=0, le=1000)
    most_sway_deg: float = setting(0.6, "from view to view; more is a loose camera", _DOES, gt=0, le=90)
    most_sway_m: float = setting(0.02, "likewise in height", _DOES, gt=0, le=10)
    steep: float = setting(
        0.2, "of one view: least sine of the angle of a ray below the horizon that gives the height", _DOES, gt=0, lt=1
    )
    bin_log: float = setting(0.08, "of one view: steps of the height's logarithm, 8 %", _DOES, gt=0, le=1)
    range_log: float = setting(2.3, "of one view: ten times as high or as low at most", _DOES, gt=0, le=10)
    steepest_deg: float = setting(
        45.0,
        "of one view: slope, degrees, from which on the lowest that is seen is a wall and no floor",
        "computed: halfway from one to the other",
        gt=0,
        lt=90,
    )


class MountSettings(Settings):
    """How the mount is fitted to the motions of wheels and camera."""

    segment_m: float = setting(0.3, "of a piece: long beside the camera's noise", _DOES, gt=0, le=100)
    segment_rad: float = setting(0.25, "or a turn of so much", _DOES, gt=0, le=3)
    largest_delay_s: float = setting(0.5, "between clocks, that is searched", _DOES, gt=0, le=10)
    slide_sigma_s: float = setting(
        0.02, "how far tyres may creep outwards in bends, as `MountFit.slide_s`", _DOES, gt=0, le=10
    )


class TurningSettings(Settings):
    """How turns of wheels and camera are compared, to find up and the delay roughly."""

    largest_offset_s: float = setting(10.0, "between clocks, that is searched", _DOES, gt=0, le=1000)
    step_s: float = setting(0.02, "of that search; fits refine it", _DOES, gt=0, le=1)
    interval_s: float = setting(0.25, "over which turns are compared", _DOES, gt=0, le=10)
    longest_interval_s: float = setting(1.0, "longer ones hide a gap", _DOES, gt=0, le=100)
    fewest_share: float = setting(0.5, "of intervals that must share time with readings", _DOES, ge=0, le=1)


class SightingSettings(Settings):
    """What is kept of depth images while a drive is watched."""

    rows: int = setting(30, "of the grid to which images are thinned", _DOES, gt=0, le=10_000)
    first_period_s: float = setting(0.5, "between views, doubled when many are kept", _DOES, gt=0, le=100)
    most_views: int = setting(400, "kept, so that memory stays flat", _DOES, ge=2, le=10**6)


class DriveSettings(Settings):
    """What a drive must show, and how certain its outcome must be."""

    sample_s: float = setting(0.5, "at which the wheels' turns are added up", _DOES, gt=0, le=10)
    least_way_m: float = setting(2.0, "without it, where it looks stays unseen", _DOES, gt=0, le=1000)
    least_turn_rad: float = setting(1.0, "in all; without it, x and y stay unseen", _DOES, gt=0, le=1000)
    least_shared_s: float = setting(5.0, "for which readings and frames overlap", _DOES, gt=0, le=1e4)
    least_tracked_share: float = setting(0.5, "of the frames that are tracked", _DOES, ge=0, le=1)
    fewest_tracked: int = setting(50, "frames that are tracked", _DOES, gt=0, le=10**6)
    least_agreement: float = setting(0.6, "correlation of the turns of wheels and camera", _DOES, ge=0, le=1)
    fewest_segments: int = setting(24, "pieces, to judge them by one another", _DOES, gt=0, le=10**6)
    most_tilt_deg: float = setting(4.0, "of the floor against the axis of turning", _DOES, gt=0, le=90)
    largest_factor: float = setting(1.25, "of the wheels' sizes against nominal ones", _DOES, gt=1, le=100)
    most_uncertain_deg: float = setting(1.0, "σ of angles: a protractor does as well", _DOES, gt=0, le=90)
    most_uncertain_m: float = setting(0.02, "σ of places: a tape measure does as well", _DOES, gt=0, le=10)
    most_uncertain_s: float = setting(0.02, "σ of the delay", _DOES, gt=0, le=10)
    far_off_deg: float = setting(
        30.0, "of the mount from its nominal one, beyond which a warning says so", _DOES, gt=0, le=180
    )


class ExtrinsicsSettings(Settings):
    """All of them."""

    agreement: AgreementSettings = AgreementSettings()
    floor: FloorSettings = FloorSettings()
    mount: MountSettings = MountSettings()
    turning: TurningSettings = TurningSettings()
    sightings: SightingSettings = SightingSettings()
    drive: DriveSettings = DriveSettings()


DEFAULTS = ExtrinsicsSettings()
