"""ExtrinsicsSettings: what can be set about finding where a camera sits, with the reasons for the defaults.

Where no source is named, a number was chosen by reasoning and found to do on simulated drives; real drives with a
measured mount are too few to tell better.
"""

from __future__ import annotations

from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt

from wheelsight.odometry._robust_fit import RobustFitSettings
from wheelsight.settings import Settings


class AgreementSettings(Settings):
    """When wheels and camera tell of one drive, and what explains it where they do not."""

    piece_m: PositiveFloat = Field(
        default=0.06,
        le=10,
        description="a piece of the drive is over when either has gone so far: a camera errs by a millimetre or two, "
        "and a robot of half a metre a second is told of after its first three frames",
    )
    piece_rad: PositiveFloat = Field(default=0.06, le=3, description="or when either has turned so far")
    usual_m: PositiveFloat = Field(
        default=0.01, le=1, description="wheels and camera differ by it in any piece, as clocks are milliseconds apart"
    )
    usual_rad: PositiveFloat = Field(default=0.01, le=1, description="likewise in turns")
    slips: NonNegativeFloat = Field(
        default=2.0, le=100, description="of turns that nobody has to explain: times what the calibration's slip makes"
    )
    drift_rad_per_m: NonNegativeFloat = Field(
        default=0.04, le=1, description="and what radii that are unequal by 2 % do in a metre, as filters allow for"
    )
    largest_factor: float = Field(
        default=100.0, gt=1, le=1e6, description="of sizes: a gear left out; beyond, one tells of motion, the other not"
    )
    disagrees: PositiveFloat = Field(
        default=0.03,
        le=1,
        description="share of the squared motion that is left: a scale 20 % or a direction 10° off, which no data "
        "sheet, tape measure or protractor is",
    )
    explained: PositiveFloat = Field(
        default=0.015, le=1, description="share that an explanation leaves: half of it is explained well"
    )
    same_scale: PositiveFloat = Field(
        default=0.15,
        le=3,
        description="logarithm by which a floor's height may be off, by mount, tilt and what lies on it",
    )
    least_turn_deg: PositiveFloat = Field(
        default=8.0, le=90, description="of a mount that looks elsewhere; less is within what is called agreement"
    )
    largest_tilt_deg: PositiveFloat = Field(
        default=10.0, le=90, description="of a mount's up, from which on the floor would lie elsewhere too"
    )


class FloorSettings(Settings):
    """Which plane is the floor, and when it is told well enough."""

    farthest_m: PositiveFloat = Field(default=5.0, le=100, description="depth beyond tells less than it may mislead")
    least_height_m: PositiveFloat = Field(default=0.05, le=10, description="of a camera over the floor")
    highest_m: PositiveFloat = Field(default=3.0, le=100, description="likewise at most")
    bin_m: PositiveFloat = Field(default=0.04, le=1, description="steps of heights in which points are counted")
    peak_share: float = Field(
        default=0.2, gt=0, le=1, description="of the most points at one height, which many points are"
    )
    bands_m: tuple[PositiveFloat, ...] = Field(
        default=(0.15, 0.10, 0.06, 0.04, 0.04), min_length=1, description="about the plane, narrowed step by step"
    )
    robust_steps: PositiveInt = Field(default=8, le=1000, description="of reweighting, after that")
    outlier_chi2: PositiveFloat = Field(default=9.0, le=1e4, description="three standard deviations off the plane")
    fewest_points: PositiveInt = Field(default=40, le=10**6, description="that show the plane in a view")
    fewest_views: PositiveInt = Field(default=10, le=10**6, description="that show it, and at least")
    fewest_share: float = Field(default=0.25, ge=0, le=1, description="of all views")
    below_m: PositiveFloat = Field(default=0.15, le=10, description="under the plane lies what is no noise of it")
    most_below: float = Field(default=0.1, ge=0, description="of the points on it; with more below it is a table")
    most_sway_deg: PositiveFloat = Field(default=0.6, le=90, description="from view to view; more is a loose camera")
    most_sway_m: PositiveFloat = Field(default=0.02, le=10, description="likewise in height")
    steep: float = Field(
        default=0.2, gt=0, lt=1, description="of one view: the sine by which a ray points down that tells the height"
    )
    bin_log: PositiveFloat = Field(default=0.08, le=1, description="of one view: steps of the height's logarithm, 8 %")
    range_log: PositiveFloat = Field(default=2.3, le=10, description="of one view: ten times as high or as low at most")


class MountSettings(Settings):
    """How the mount is fitted to the motions of wheels and camera."""

    segment_m: PositiveFloat = Field(default=0.3, le=100, description="of a piece: long beside the camera's noise")
    segment_rad: PositiveFloat = Field(default=0.25, le=3, description="or a turn of so much")
    largest_delay_s: PositiveFloat = Field(default=0.5, le=10, description="between clocks, that is searched")
    slide_sigma_s: PositiveFloat = Field(
        default=0.02, le=10, description="how far tyres may creep outwards in bends, as `MountFit.slide_s`"
    )


class TurningSettings(Settings):
    """How turns of wheels and camera are compared, to find up and the delay roughly."""

    largest_offset_s: PositiveFloat = Field(default=10.0, le=1000, description="between clocks, that is searched")
    step_s: PositiveFloat = Field(default=0.02, le=1, description="of that search; fits refine it")
    interval_s: PositiveFloat = Field(default=0.25, le=10, description="over which turns are compared")
    longest_interval_s: PositiveFloat = Field(default=1.0, le=100, description="longer ones hide a gap")
    fewest_share: float = Field(default=0.5, ge=0, le=1, description="of intervals that must share time with readings")


class SightingSettings(Settings):
    """What is kept of depth images while a drive is watched."""

    rows: PositiveInt = Field(default=30, le=10_000, description="of the grid to which images are thinned")
    first_period_s: PositiveFloat = Field(default=0.5, le=100, description="between views, doubled when many are kept")
    most_views: int = Field(default=400, ge=2, le=10**6, description="kept, so that memory stays flat")


class DriveSettings(Settings):
    """What a drive must show, and how certain its outcome must be."""

    sample_s: PositiveFloat = Field(default=0.5, le=10, description="at which the wheels' turns are added up")
    least_way_m: PositiveFloat = Field(default=2.0, le=1000, description="without it, where it looks stays unseen")
    least_turn_rad: PositiveFloat = Field(default=1.0, le=1000, description="in all; without it, x and y stay unseen")
    least_shared_s: PositiveFloat = Field(default=5.0, le=1e4, description="for which readings and frames tell both")
    least_tracked_share: float = Field(default=0.5, ge=0, le=1, description="of the frames that are tracked")
    fewest_tracked: PositiveInt = Field(default=50, le=10**6, description="frames that are tracked")
    least_agreement: float = Field(default=0.6, ge=0, le=1, description="correlation of the turns of wheels and camera")
    fewest_segments: PositiveInt = Field(default=24, le=10**6, description="pieces, to judge them by one another")
    most_tilt_deg: PositiveFloat = Field(default=4.0, le=90, description="of the floor against the axis of turning")
    largest_factor: float = Field(default=1.25, gt=1, le=100, description="of the wheels' sizes against nominal ones")
    most_uncertain_deg: PositiveFloat = Field(default=1.0, le=90, description="σ of angles: a protractor does as well")
    most_uncertain_m: PositiveFloat = Field(default=0.02, le=10, description="σ of places: a tape measure does as well")
    most_uncertain_s: PositiveFloat = Field(default=0.02, le=10, description="σ of the delay")
    far_off_deg: PositiveFloat = Field(
        default=30.0, le=180, description="of the mount from its nominal one, beyond which a warning says so"
    )


class ExtrinsicsSettings(Settings):
    """All of them."""

    agreement: AgreementSettings = AgreementSettings()
    floor: FloorSettings = FloorSettings()
    mount: MountSettings = MountSettings()
    turning: TurningSettings = TurningSettings()
    sightings: SightingSettings = SightingSettings()
    drive: DriveSettings = DriveSettings()
    fit: RobustFitSettings = RobustFitSettings()


DEFAULTS = ExtrinsicsSettings()
