"""Settings of loop closing and of the maps that are kept between drives."""

from __future__ import annotations

from wheelsight.core.settings import ASKED, CHOSEN, Settings, setting
from wheelsight.mapping.settings import OccupancySettings

# LoopSettings: which loops a pose graph takes in, with the reasons for the defaults.


FROM_NOWHERE, FROM_MATCHES, FROM_KEYFRAMES = "none", "matches", "keyframes"
"""Of `LoopSettings.source`, beside the path of a file."""

_FROM_0053 = "docs/decisions/0053: synthetic graphs, found on the simulator alone"


class StepSettings(Settings):
    """What is added to the error of the way from a keyframe to the next."""

    plane_sigma_m: float = setting(
        1e-3,
        "added to the error of each step, metres a coordinate: odometry in a plane states none out of it",
        "reckoned: floors are level to some millimetres a metre",
        gt=0,
        le=1,
    )
    plane_sigma_rad: float = setting(1e-3, "likewise, radians an axis", "reckoned, likewise", gt=0, le=1)


class MatchSettings(StepSettings):
    """What a match from outside is worth where its file does not say; see `wheelsight.core.messages`."""

    least_score: float = setting(
        0.5, "matches with a score below are not looked at: they are more probably wrong than right", CHOSEN, ge=0, le=1
    )
    place_sigma_m: float = setting(
        1.0,
        "standard deviation of each coordinate between two views of one place, metres; of the heading nothing is said,"
        " since some cameras see all around",
        "reckoned: what place recognition takes for one place spans some metres",
        gt=0,
        le=100,
    )
    pose_sigma_m: float = setting(
        0.1, "standard deviation of a relative pose whose file states none, metres a coordinate", CHOSEN, gt=0, le=100
    )
    pose_sigma_rad: float = setting(0.05, "likewise, radians an axis", CHOSEN, gt=0, le=3)
    most_gap_s: float = setting(
        0.2, "a match is of the pose nearest in time, at most so far off, seconds", CHOSEN, ge=0, le=3600
    )
    keyframe_way_m: float = setting(
        1.0, "way after which there is a keyframe where no match asks for one, metres", CHOSEN, gt=0, le=1000
    )


class SeenSettings(Settings):
    """Which keyframes are asked whether they show a place again."""

    apart_s: float = setting(
        3.0,
        "seconds between two keyframes that may show a place again: of what was just seen odometry knows",
        CHOSEN,
        ge=0,
        le=3600,
    )
    candidates: int = setting(5, "keyframes that are verified at most for each", CHOSEN, ge=1, le=1000)
    candidates_adrift: int = setting(
        24,
        "and of the rest of the map, while nobody knows where in that they lie",
        "docs/decisions/0111; fewer than of a single view, since each keyframe asks anew",
        ge=1,
        le=1000,
    )
    near_candidates: int = setting(
        2,
        "of these, keyframes that lie near by what is known: under another light they may look as others",
        CHOSEN,
        ge=0,
        le=100,
    )
    near_m: float = setting(1.0, "how near, metres; a turn by a radian counts as 1.5 m", CHOSEN, gt=0, le=10)
    most_places: int = setting(5, "verified ones that are enough for each", CHOSEN, ge=1, le=100)


class PieceSettings(Settings):
    """How a lost camera alone begins another piece of map, which loops may join with the old one."""

    speed_m_s: float = setting(
        1.0,
        "how fast a camera may have been carried while nothing was seen, as a standard deviation",
        CHOSEN,
        gt=0,
        le=100,
    )
    turn_rad_s: float = setting(1.0, "how fast it may have turned, likewise", CHOSEN, gt=0, le=100)
    most_rad: float = setting(
        2.0, "a heading is no less certain than this, whatever happened", "reckoned: any is 1.8", gt=0, le=10
    )
    apart_m: float = setting(
        200.0,
        "how far below the map, metres, pieces are kept of which nobody knows where they lie, so that none is seen from"
        " another",
        "reckoned: surfels there are still placed to 0.02 mm",
        gt=0,
        le=10_000,
    )


class LoopSettings(Settings):
    """Where loops come from, and which are kept."""

    source: str = setting(
        "none",
        "none; keyframes: places that the camera sees again, while driving; matches: those of the recording, and of a "
        "loops.csv in its folder; or a file like that",
        ASKED,
    )
    gate_probability: float = setting(
        0.999, "share of true loops that pass the chi-square gate, where all covariances are honest", CHOSEN, gt=0, lt=1
    )
    cauchy_scale: float = setting(
        1.0, "standard deviations from which on Cauchy's kernel lets go of a loop", _FROM_0053, gt=0, le=100
    )
    review_after: int = setting(
        10, "loops refused since the last review of all of them after which there is another", CHOSEN, ge=1, le=100_000
    )
    cluster_keyframes: int = setting(
        5, "loops so many keyframes apart at either end, or fewer, may be of one stretch", CHOSEN, ge=0, le=1000
    )
    cluster_votes: float = setting(
        3.0,
        "loops that agree count as so many at most in each stretch of `cluster_keyframes`: what takes one view for"
        " another does so again beside",
        _FROM_0053,
        gt=0,
        le=1000,
    )
    least_members: int = setting(3, "a refused cluster of fewer is no hypothesis by itself", CHOSEN, ge=1, le=1000)
    most_appeals: int = setting(
        4, "refused clusters, the largest first, that are tried in one review", "reckoned: its time", ge=0, le=1000
    )
    least_gain: float = setting(
        5.0,
        "log-likelihood by which other poses must explain all measurements better to be taken: 150 to 1",
        CHOSEN,
        ge=0,
        le=1000,
    )
    most_rounds: int = setting(5, "rounds of judging and solving until none changes sides", CHOSEN, ge=1, le=100)
    latency_s: float = setting(
        1.0,
        "a recording's keyframes are answered so long after them, by their stamps, in seconds: as late on each machine",
        "reckoned: to recognise and verify takes a tenth of that or two",
        ge=0,
        le=60,
    )
    most_waiting: int = setting(
        5, "keyframes of a robot that drives may wait; of more nobody asks what they show", CHOSEN, ge=1, le=10_000
    )
    least_shift_m: float = setting(
        0.002, "where loops move keyframes by less, they stay; a turn by a radian counts as 1.5 m", CHOSEN, ge=0, le=10
    )
    known_sigma_m: float = setting(
        0.3, "how far keyframes of a map that is extended may be off where they are, metres", CHOSEN, gt=0, le=100
    )
    known_sigma_rad: float = setting(0.1, "likewise, radians", CHOSEN, gt=0, le=3)
    agree_m: float = setting(
        0.3,
        "two loops that join pieces of a map put them to one place, metres apart at most, and each is as sure itself",
        CHOSEN,
        gt=0,
        le=100,
    )
    join_apart_m: float = setting(
        0.5,
        "and are seen from so far apart at least, a turn by a radian as 1.5 m: what takes one view for another does so"
        " again beside",
        CHOSEN,
        ge=0,
        le=100,
    )
    join_majority: float = setting(
        2.0, "for each loop between these pieces that says otherwise, so many have to agree", CHOSEN, ge=0, le=1000
    )
    sure_m: float = setting(
        0.15,
        "where a piece lies counts as known once the standard deviation of a pose in the map is at most this, metres"
        " along the worst axis",
        "reckoned: a place 0.5 m off is a wrong one, and this is less than a third of that",
        gt=0,
        le=100,
    )
    sure_rad: float = setting(0.06, "likewise, radians", "reckoned, likewise: of 10 degrees", gt=0, le=3)
    unsure_m: float = setting(
        0.2,
        "in a map of before that stays as it is, a pose known to no better than this, metres, is `coasting`",
        "reckoned: 0.5 m, a wrong place, is 2.5 times as much; more than sure_m, so that it does not come and go",
        gt=0,
        le=100,
    )
    unsure_rad: float = setting(0.08, "likewise, radians", "reckoned, likewise", gt=0, le=3)
    most_across: int = setting(
        60,
        "loops between pieces that are remembered, the newest: of more, comparing takes long",
        "reckoned",
        ge=2,
        le=1000,
    )
    agree_rad: float = setting(0.1, "likewise, radians", CHOSEN, gt=0, le=3)
    pieces: PieceSettings = PieceSettings()
    matches: MatchSettings = MatchSettings()
    seen: SeenSettings = SeenSettings()


# SessionSettings: what is kept of a drive for the next, and how often it is written.


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
