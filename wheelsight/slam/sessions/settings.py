"""SessionSettings: what is kept of a drive for the next, and how often it is written."""

from __future__ import annotations

from wheelsight.mapping.occupancy_settings import OccupancySettings
from wheelsight.settings import ASKED, CHOSEN, Settings, setting
from wheelsight.slam.settings import StepSettings

_FROM_0056 = "two real recordings of Kinects: docs/decisions/0056"


class PruneSettings(Settings):
    """Which keyframes `wheelsight map prune` leaves out: those whose view another one shows."""

    near_m: float = setting(0.2, "how far the other one may be, metres", CHOSEN, gt=0, le=10)
    near_rad: float = setting(
        0.25, "and how far turned, radians: seen from elsewhere, keypoints are others", CHOSEN, gt=0, le=3
    )
    covered: float = setting(
        0.7,
        "share of its surfaces that the other one must show",
        "two real recordings: docs/decisions/0058",
        ge=0,
        le=1,
    )


class SessionSettings(StepSettings):
    """The map folder of a run; see docs/sessions.md."""

    keep_map: bool | None = setting(
        None, "whether the run leaves a map folder for the next drive; null: where `map: surfels` builds a map", ASKED
    )
    flush_s: float = setting(
        1.0,
        "seconds between two times at which what was written is made to outlive a loss of power",
        "reckoned: a fifth of what a kill may cost",
        gt=0,
        le=60,
    )
    settled_frames: int = setting(
        2,
        "frames after which a keyframe is written: the first is straightened once the second tells the camera's speed",
        "reckoned",
        ge=0,
        le=100,
    )
    moved_poses: int = setting(
        8,
        "poses of keyframes that have moved that are written while driving, for each new keyframe, 104 bytes each; "
        "those that moved most come first, and all at the end",
        "a hundredth of a keyframe's 100 kB: docs/decisions/0102",
        ge=1,
        le=10_000,
    )
    piece_keyframes: int = setting(
        64, "keyframes of a journal, after which another begins: 4 MB", "reckoned", ge=1, le=10_000
    )
    memory_keyframes: int = setting(
        128,
        "keyframes of a map that are held in memory, those asked for last: 23 MB; of a drive that writes one twice "
        "as many, the newest; with so many newer ones behind it a keyframe is recalled as it is on disk",
        "what an hour of driving may take, 1 GB: docs/decisions/0096",
        ge=1,
        le=1_000_000,
    )
    width_px: int = setting(
        320,
        "width of images that are kept, at most: larger ones are halved, as whoever recognises by them does too",
        "as `dense.finest_width_px`",
        ge=16,
        le=4096,
    )
    depth_sigmas: float = setting(
        2.0,
        "depth is kept in steps of so many standard deviations of its noise",
        _FROM_0056,
        gt=0,
        le=10,
    )
    grey_step: int = setting(8, "grey is kept in steps of so many levels of 255", _FROM_0056, ge=1, le=32)
    most_kb: int = setting(
        86,
        "kilobytes of a keyframe, at most; where images leave no room for all keypoints, some are left out, evenly",
        "what issue 31 allows, 100 kB, without what recognises it, its pose and its edges",
        ge=1,
        le=100_000,
    )
    least_keypoints: int = setting(300, "that are kept even so", "as `recognition.words.descriptors`", ge=0, le=20_000)
    camera_share: float = setting(
        0.02,
        "share by which focal lengths, and of the image's size its middle, may differ between a map's camera and "
        "another that goes for the same",
        "reckoned: two calibrations of one Kinect differ by 1 %",
        ge=0,
        le=1,
    )
    rebuild_frames: int = setting(
        6,
        "frames that a keyframe counts as where the surfel map is fused anew of keyframes alone: two of them make "
        "a surfel stable",
        "reckoned: `surfels.stable_confidence` is 10",
        gt=0,
        le=1000,
    )
    sure_m: float = setting(
        0.5,
        "standard deviation from which on an edge does not tell how its ends lie to each other, as of a camera that "
        "was carried off, metres",
        CHOSEN,
        gt=0,
        le=100,
    )
    sure_rad: float = setting(0.3, "likewise, radians", CHOSEN, gt=0, le=3)
    prune: PruneSettings = PruneSettings()
    occupancy: OccupancySettings = OccupancySettings()
