"""What others have published of a recording, beside what is measured here; and what wheelsight must reach there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from benchmarks.contenders import opencv_odometry, wheelsight_dense, wheelsight_features
from benchmarks.run import Result
from benchmarks.targets import Target

# Better than most of what is published, with a lens and clocks as others had them; found on no recording.
BEST_ATE_M, EACH_ATE_M, TIME_SHARE_OF_OPENCV = 0.016, 0.020, 0.2
OURS = (wheelsight_features.KEYFRAMES, wheelsight_dense.KEYFRAMES, wheelsight_dense.SURFELS)


@dataclass(frozen=True, slots=True)
class Published:
    """An absolute trajectory error that a system's authors give, RMSE in metres, on other machines."""

    system: str
    ate_m: float
    source: str


# On the whole of TUM's freiburg1_desk.
_DESK = (
    Published("ORB-SLAM2", 0.016, "Mur-Artal & Tardós, T-RO 2017; it closes loops"),
    Published("ElasticFusion", 0.020, "Whelan et al., RSS 2015; on a GPU"),
    Published("DVO-SLAM", 0.021, "Kerl et al., IROS 2013; it closes loops"),
    Published("RTAB-Map", 0.029, "Labbé & Michaud, JFR 2019; it closes loops"),
)
_OF_SEQUENCE = {"freiburg1_desk": _DESK, "rgbd_dataset_freiburg1_desk": _DESK}


def published_of(sequence: str) -> tuple[Published, ...]:
    """What is published of a recording, by its name; of parts of one nothing is."""
    return _OF_SEQUENCE.get(sequence, ())


def judge_published(results: Sequence[Result]) -> list[Target]:
    """What each of ours must reach where others have published."""
    names = dict.fromkeys(result.sequence for result in results)
    return [target for name in names if published_of(name) for target in _of_sequence(name, results)]


def _of_sequence(name: str, results: Sequence[Result]) -> Iterator[Target]:
    here = {r.contender.name: r.figures for r in results if r.sequence == name and r.figures is not None}
    ours = {contender.name: here[contender.name] for contender in OURS if contender.name in here}
    opencv = here.get(opencv_odometry.RGB_DEPTH.name)
    limit_ms = None if opencv is None else TIME_SHARE_OF_OPENCV * opencv.median_ms
    known = [figures.accuracy.ate_m for figures in ours.values() if figures.accuracy.ate_m is not None]
    for what, figures in ours.items():
        yield Target(f"{name}: {what}, poses", figures.frames, figures.with_pose, "poses", 0, is_least=True)
        yield Target(f"{name}: {what}, ATE", EACH_ATE_M, figures.accuracy.ate_m, "m", 4)
        share = f"{TIME_SHARE_OF_OPENCV:g} of OpenCV's"
        yield Target(f"{name}: {what}, median time, {share}", limit_ms, figures.median_ms, "ms")
    yield Target(f"{name}: ATE of the best of ours", BEST_ATE_M, min(known, default=None), "m", 4)
