"""RecognitionSettings: by what a place is recognised, and when it is believed to be the same."""

from __future__ import annotations

from wheelsight.settings.base import CHOSEN, Settings, setting

_FERNS = "Glocker et al. 2015"
_FROM_0052 = "two real recordings of Kinects: docs/decisions/0052"


class FernSettings(Settings):
    """The code of a view: random comparisons on a tiny image of grey and depth."""

    ferns: int = setting(
        512, "of 4 bits each; the paper takes 500, 16 fill a word", _FERNS, ge=16, le=8192, multiple_of=16
    )
    width_px: int = setting(
        40, "of the tiny image, pixels: of 640×480 the paper takes a sixteenth", _FERNS, ge=4, le=640
    )
    height_px: int = setting(30, "likewise", _FERNS, ge=4, le=480)
    blur_px: float = setting(
        1.0,
        "standard deviation of the blur over the tiny image, pixels; the paper has 2.5 over 5 px",
        CHOSEN,
        gt=0,
        le=50,
    )
    grey_sigmas: float = setting(
        1.2,
        "thresholds of grey lie within so many standard deviations of an image's grey about its mean: light and "
        "exposure change both",
        CHOSEN,
        gt=0,
        le=10,
    )
    nearest_m: float = setting(0.5, "thresholds of depth go from here, metres", CHOSEN, gt=0, le=100)
    farthest_m: float = setting(
        6.0, "to here, metres, as far as depth cameras see indoors; the paper has 0.4 to 4 m", CHOSEN, gt=0, le=1000
    )


class WordSettings(Settings):
    """Words of descriptors: a tree that grows with the keyframes."""

    descriptors: int = setting(300, "of a keyframe that become words; each takes 36 bytes", CHOSEN, ge=1, le=20_000)
    branching: int = setting(8, "nodes into which a full one is split", CHOSEN, ge=2, le=64)
    split_at: int = setting(64, "descriptors of a word at which it is split", CHOSEN, ge=4, le=10_000)
    steps: int = setting(3, "rounds in which the centres of such nodes are bettered", CHOSEN, ge=1, le=100)
    depth: int = setting(8, "levels of the tree at most", CHOSEN, ge=1, le=16)
    most_postings: int = setting(
        10_000,
        "keyframes that are counted for the words of one view, those of rare words first: it bounds the time",
        "measured by python -m benchmarks.relocalization: 0.2 ms",
        ge=1,
        le=100_000_000,
    )
    most_nodes: int = setting(32_000, "of the tree; then no word is split any more", CHOSEN, ge=16, le=10_000_000)


class PlaceVerificationSettings(Settings):
    """When a view shows the place of a keyframe, and how exactly that is known."""

    max_hamming: int = setting(
        64, "bits by which descriptors of one point may differ", "as in `features`", ge=1, le=256
    )
    keypoint_px: float = setting(
        1.0,
        "standard deviation of a keypoint's pixel at a middle scale, by `features.sigma_px` and `sigma_growth`",
        "reckoned from `features`",
        gt=0,
        le=10,
    )
    iterations: int = setting(
        4000,
        "of RANSAC at most: of views from far apart one match in ten is right, and three must be",
        "reckoned: 0.1³ of 4000 is 4, so one is found in 98 %",
        ge=1,
        le=1_000_000,
    )
    min_inliers: int = setting(
        8,
        "keypoints that must agree on a motion for surfaces to be asked: at wrong places 6 and 7 often agree",
        _FROM_0052,
        ge=4,
        le=20_000,
    )
    clear_inliers: int = setting(
        40,
        "keypoints that must agree to count along directions that surfaces don't show; fewer fit the next door of a "
        "corridor too",
        CHOSEN,
        ge=4,
        le=20_000,
    )
    clear_share: float = setting(
        0.5,
        "or this share of those matched: 63 to 96 % at the right place, 19 to 26 % in another stretch of a corridor",
        "found on the simulator alone: docs/decisions/0025",
        gt=0,
        le=1,
    )
    correlation: float = setting(
        20.0, "how many neighbouring keypoints err as one", "as in `dense.verification`", gt=0, le=1e6
    )
    agree_m: float = setting(
        0.15,
        "metres by which surfaces may lead away from where keypoints are, few as these may be",
        CHOSEN,
        gt=0,
        le=10,
    )
    agree_rad: float = setting(0.12, "radians likewise, 7 degrees", CHOSEN, gt=0, le=3.2)
    min_overlap: float = setting(
        0.15,
        "share of the view's points that must find a surface of the keyframe; of less, an edge of a table fits many "
        "places",
        _FROM_0052,
        gt=0,
        lt=1,
    )
    max_residual: float = setting(
        5.0, "mean residual of surfaces, in standard deviations of the sensor", "as in `dense`", gt=0, le=1000
    )
    free_m: float = setting(
        0.06,
        "metres before a surface that was seen within which what stands there is that surface",
        CHOSEN,
        gt=0,
        le=10,
    )
    free_share: float = setting(
        0.03, "and so much of its depth: depth of real cameras is bent by 1 or 2 %", CHOSEN, ge=0, le=1
    )
    free_sigmas: float = setting(3.0, "and so many standard deviations of depth", CHOSEN, ge=0, le=100)
    free_px: int = setting(
        1, "pixels about, of the coarsest level, of which the nearest depth is the surface", CHOSEN, ge=0, le=20
    )
    max_intruding: float = setting(
        0.12,
        "share of what both views could see that may stand where the other saw through: people and moved chairs",
        CHOSEN,
        ge=0,
        le=1,
    )
    max_free: float = setting(
        0.5,
        "and so much of it may be of things that stand free of what is about them, such as somebody close by; then the"
        " rest is judged by that",
        "reckoned: as much must speak for the place",
        ge=0,
        le=1,
    )
    registration_sigma_m: float = setting(
        0.01,
        "standard deviation of a place by surfaces seen from apart, metres, beyond what single frames and the camera's"
        " points are off by",
        "freiburg1_desk against motion capture: docs/decisions/0122",
        ge=0,
        le=10,
    )
    registration_sigma_rad: float = setting(
        0.01, "likewise, radians", "freiburg1_desk against motion capture: docs/decisions/0122", ge=0, le=3.2
    )
    unseen_sigma_m: float = setting(
        10.0, "standard deviation along directions that are not known, turns as ways at 2 m", CHOSEN, gt=0, le=1e6
    )
    most_unseen: int = setting(
        2,
        "directions of six that may be unknown: a corridor leaves one; a single plane leaves three, and is no place",
        "reckoned",
        ge=0,
        le=5,
    )
    agree_chi2: float = setting(
        22.5,
        "up to which two answers about one stretch say the same: χ² of 6, 99.9 %",
        "reckoned: χ² of 6",
        gt=0,
        le=1e6,
    )


class RecognitionSettings(Settings):
    """How places are recognised; see docs/recognition.md."""

    seed: int = setting(0, "of ferns and of RANSAC", CHOSEN, ge=0, lt=2**32)
    candidates: int = setting(
        64,
        "keyframes that are verified at most, for one view: one that shows another place costs 1 to 2 ms",
        "two real recordings of Kinects, docs/decisions/0116; reckoned: its time, 100 ms where none shows the place",
        ge=1,
        le=1000,
    )
    apart_m: float = setting(
        0.05,
        "metres between two keyframes that count as two, a turn by a radian as 1.5 m: one image twice confirms nothing",
        CHOSEN,
        ge=0,
        le=10,
    )
    fused_rank: float = setting(
        60.0,
        "added to ranks before the two orders, by ferns and by words, are joined by the sum of 1 / rank",
        "Cormack et al. 2009",
        gt=0,
        le=1e6,
    )
    ranked: int = setting(64, "keyframes of each order that are joined", CHOSEN, ge=1, le=100_000)
    ferns: FernSettings = FernSettings()
    words: WordSettings = WordSettings()
    verification: PlaceVerificationSettings = PlaceVerificationSettings()
