"""Settings of loop closing and of the maps that are kept between drives."""

from __future__ import annotations

from wheelsight.core.settings import ASKED, CHOSEN, Settings, setting
from wheelsight.mapping import OccupancySettings

FROM_NOWHERE, FROM_MATCHES, FROM_KEYFRAMES = "none", "matches", "keyframes"
"""Values of `LoopSettings.source`, other than the path of a file."""

_FROM_0053 = "docs/decisions/0053: synthetic graphs, found on the simulator alone"


class StepSettings(Settings):
    """Least errors of odometry between successive keyframes."""

    plane_sigma_m: float = setting(
        1e-3,
        "added to the error of each odometry step, metres per coordinate: planar odometry has no error out of"
        " the plane",
        "estimated: floors are level to some millimetres per metre",
        gt=0,
        le=1,
    )
    plane_sigma_rad: float = setting(1e-3, "likewise, radians per axis", "estimated, likewise", gt=0, le=1)


class MatchSettings(StepSettings):
    """Uncertainty of external matches without their own; see `wheelsight.core.messages`."""

    least_score: float = setting(
        0.5, "matches with a lower score are ignored: they are more probably wrong than right", CHOSEN, ge=0, le=1
    )
    place_sigma_m: float = setting(
        1.0,
        "standard deviation of each coordinate between two views of one place, metres; the heading is "
        "unknown, since some cameras see all around",
        "estimated: place recognition accepts views some metres apart",
        gt=0,
        le=100,
    )
    pose_sigma_m: float = setting(
        0.1, "standard deviation of a relative pose whose file has none, metres per coordinate", CHOSEN, gt=0, le=100
    )
    pose_sigma_rad: float = setting(0.05, "likewise, radians per axis", CHOSEN, gt=0, le=3)
    most_gap_s: float = setting(
        0.2, "largest time between a match and its nearest pose, seconds", CHOSEN, ge=0, le=3600
    )
    keyframe_way_m: float = setting(
        1.0, "distance after which a keyframe is made without a match, metres", CHOSEN, gt=0, le=1000
    )


class SeenSettings(Settings):
    """Candidates of place recognition."""

    apart_s: float = setting(
        3.0,
        "least time between two keyframes of a loop, seconds: odometry links recent ones",
        CHOSEN,
        ge=0,
        le=3600,
    )
    candidates: int = setting(5, "largest number of candidates verified for each keyframe", CHOSEN, ge=1, le=1000)
    candidates_adrift: int = setting(
        24,
        "largest number of further candidates in the map, while the pose in it is unknown",
        "docs/decisions/0111; fewer than for a single view, since each keyframe tries again",
        ge=1,
        le=1000,
    )
    near_candidates: int = setting(
        2,
        "of these, number of keyframes near the current pose: under other light they may look different",
        CHOSEN,
        ge=0,
        le=100,
    )
    near_m: float = setting(
        1.0, "largest distance of such keyframes, metres; a turn by a radian counts as 1.5 m", CHOSEN, gt=0, le=10
    )
    most_places: int = setting(5, "number of verified places that are enough for each keyframe", CHOSEN, ge=1, le=100)


class PieceSettings(Settings):
    """New pieces of a map after the camera is lost, which loops may join with the old one."""

    speed_m_s: float = setting(
        1.0,
        "standard deviation of the speed of a camera that sees nothing, as when carried",
        CHOSEN,
        gt=0,
        le=100,
    )
    turn_rad_s: float = setting(1.0, "standard deviation of its turn rate, likewise", CHOSEN, gt=0, le=100)
    most_rad: float = setting(
        2.0, "largest standard deviation of a heading", "estimated: that of any heading is 1.8", gt=0, le=10
    )
    apart_m: float = setting(
        200.0,
        "distance below the map, metres, at which unjoined pieces are kept, so that none is visible from another",
        "estimated: surfels there are still placed to 0.02 mm",
        gt=0,
        le=10_000,
    )


class LoopSettings(Settings):
    """Source of loops, and which are kept."""

    source: str = setting(
        "none",
        "none; keyframes: places that the camera sees again, while driving; matches: those of the recording, and of a "
        "loops.csv in its folder; or a file like that",
        ASKED,
    )
    gate_probability: float = setting(
        0.999, "share of true loops that pass the chi-square gate, with correct covariances", CHOSEN, gt=0, lt=1
    )
    cauchy_scale: float = setting(
        1.0, "standard deviations above which the Cauchy kernel reduces a loop's weight", _FROM_0053, gt=0, le=100
    )
    review_after: int = setting(10, "refused loops after which all loops are reviewed", CHOSEN, ge=1, le=100_000)
    cluster_keyframes: int = setting(
        5, "largest distance, in keyframes at either end, of neighbouring loops in a cluster", CHOSEN, ge=0, le=1000
    )
    cluster_votes: float = setting(
        3.0,
        "largest weight of loops that agree, in each stretch of `cluster_keyframes`: a repeated wrong match "
        "agrees with itself",
        _FROM_0053,
        gt=0,
        le=1000,
    )
    least_members: int = setting(3, "least size of a refused cluster that becomes a hypothesis", CHOSEN, ge=1, le=1000)
    most_appeals: int = setting(
        4,
        "largest number of refused clusters, the largest first, tried in a review",
        "estimated: its time",
        ge=0,
        le=1000,
    )
    least_gain: float = setting(
        5.0,
        "log-likelihood ratio by which another hypothesis must explain all measurements better: 150 to 1",
        CHOSEN,
        ge=0,
        le=1000,
    )
    most_rounds: int = setting(5, "largest number of rounds of gating and optimisation", CHOSEN, ge=1, le=100)
    latency_s: float = setting(
        1.0,
        "time after which the result of a recording's keyframe is used, in seconds of its stamps: "
        "reproducible on each machine",
        "estimated: recognition and verification take a tenth or two of it",
        ge=0,
        le=60,
    )
    most_waiting: int = setting(
        5,
        "largest number of queued keyframes of a driving robot; further ones are not compared",
        CHOSEN,
        ge=1,
        le=10_000,
    )
    least_shift_m: float = setting(
        0.002, "least motion of keyframes that is reported; a turn by a radian counts as 1.5 m", CHOSEN, ge=0, le=10
    )
    known_sigma_m: float = setting(
        0.3, "standard deviation of keyframe positions in a map that is extended, metres", CHOSEN, gt=0, le=100
    )
    known_sigma_rad: float = setting(0.1, "likewise, radians", CHOSEN, gt=0, le=3)
    agree_m: float = setting(
        0.3,
        "largest difference of two loops that join pieces of a map, and of their standard deviations, metres",
        CHOSEN,
        gt=0,
        le=100,
    )
    join_apart_m: float = setting(
        0.5,
        "least distance of their viewpoints, a turn by a radian as 1.5 m: a repeated wrong match agrees with itself",
        CHOSEN,
        ge=0,
        le=100,
    )
    join_majority: float = setting(
        2.0, "number of loops that must agree for each loop between the pieces that contradicts", CHOSEN, ge=0, le=1000
    )
    sure_m: float = setting(
        0.15,
        "a piece counts as joined once the standard deviation of a pose in the map is at most this, metres "
        "along the worst axis",
        "estimated: a place 0.5 m off is wrong, and this is less than a third of it",
        gt=0,
        le=100,
    )
    sure_rad: float = setting(0.06, "likewise, radians", "estimated, likewise: of 10 degrees", gt=0, le=3)
    unsure_m: float = setting(
        0.2,
        "in a fixed known map, a pose with a larger standard deviation, metres, is `coasting`",
        "estimated: 0.5 m, a wrong place, is 2.5 times as much; larger than sure_m, so that the status does "
        "not alternate",
        gt=0,
        le=100,
    )
    unsure_rad: float = setting(0.08, "likewise, radians", "estimated, likewise", gt=0, le=3)
    most_across: int = setting(
        60,
        "largest number of loops between pieces that are kept, the newest: comparing more takes long",
        "estimated",
        ge=2,
        le=1000,
    )
    agree_rad: float = setting(0.1, "likewise, radians", CHOSEN, gt=0, le=3)
    pieces: PieceSettings = PieceSettings()
    matches: MatchSettings = MatchSettings()
    seen: SeenSettings = SeenSettings()


_FROM_0056 = "two real recordings of Kinects: docs/decisions/0056"


class PruneSettings(Settings):
    """Keyframes removed by `wheelsight map prune`: those whose view another one shows."""

    near_m: float = setting(0.2, "largest distance of the keyframe that shows the same, metres", CHOSEN, gt=0, le=10)
    near_rad: float = setting(
        0.25, "and the largest turn, radians: from another direction, keypoints differ", CHOSEN, gt=0, le=3
    )
    covered: float = setting(
        0.7,
        "least share of surfaces that the other keyframe must show",
        "two real recordings: docs/decisions/0058",
        ge=0,
        le=1,
    )


class SessionSettings(StepSettings):
    """Map folder of a run; see docs/sessions.md."""

    keep_map: bool | None = setting(
        None, "whether the run writes a map folder for the next drive; null: if `map: surfels` builds a map", ASKED
    )
    flush_s: float = setting(
        1.0,
        "seconds between flushes, after which data survives a loss of power",
        "estimated: a fifth of what a kill may cost",
        gt=0,
        le=60,
    )
    settled_frames: int = setting(
        2,
        "frames after which a keyframe is written: the first one is undistorted once the second shows the "
        "camera's speed",
        "estimated",
        ge=0,
        le=100,
    )
    moved_poses: int = setting(
        8,
        "changed poses written while driving, for each new keyframe, 104 bytes each; the largest changes "
        "first, and all at the end",
        "a hundredth of a keyframe's 100 kB: docs/decisions/0102",
        ge=1,
        le=10_000,
    )
    piece_keyframes: int = setting(64, "keyframes per journal: 4 MB", "estimated", ge=1, le=10_000)
    memory_keyframes: int = setting(
        128,
        "keyframes of a map held in memory, the most recently used: 23 MB; twice as many of a drive that "
        "writes one, the newest; older ones are read from disk",
        "what an hour of driving may take, 1 GB: docs/decisions/0096",
        ge=1,
        le=1_000_000,
    )
    width_px: int = setting(
        320,
        "largest width of stored images: larger ones are halved, as recognition does too",
        "as `dense.finest_width_px`",
        ge=16,
        le=4096,
    )
    depth_sigmas: float = setting(
        2.0,
        "depth is stored in steps of this many standard deviations of its noise",
        _FROM_0056,
        gt=0,
        le=10,
    )
    grey_step: int = setting(8, "grey is stored in steps of this many levels of 255", _FROM_0056, ge=1, le=32)
    most_kb: int = setting(
        86,
        "largest size of a keyframe, kilobytes; if images leave no room for all keypoints, some are left out, evenly",
        "what issue 31 allows, 100 kB, without what recognises it, its pose and its edges",
        ge=1,
        le=100_000,
    )
    least_keypoints: int = setting(
        300, "least number of keypoints stored even so", "as `recognition.words.descriptors`", ge=0, le=20_000
    )
    camera_share: float = setting(
        0.02,
        "largest difference of focal lengths, and of the principal point relative to the image size, between "
        "cameras that count as the same",
        "estimated: two calibrations of one Kinect differ by 1 %",
        ge=0,
        le=1,
    )
    rebuild_frames: int = setting(
        6,
        "frames that a keyframe counts as when surfels are fused from keyframes alone: two keyframes make a "
        "surfel stable",
        "estimated: `surfels.stable_confidence` is 10",
        gt=0,
        le=1000,
    )
    sure_m: float = setting(
        0.5,
        "standard deviation above which an edge does not connect its keyframes, as of a camera that was "
        "carried away, metres",
        CHOSEN,
        gt=0,
        le=100,
    )
    sure_rad: float = setting(0.3, "likewise, radians", CHOSEN, gt=0, le=3)
    prune: PruneSettings = PruneSettings()
    occupancy: OccupancySettings = OccupancySettings()
