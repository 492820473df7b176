"""How good an estimated trajectory is: ATE and RPE as the TUM benchmark defines them, coverage, sequence statistics."""

from wheelsight.evaluation.consistency import (
    THREE_SIGMA_RADIUS,
    Consistency,
    consistency,
    covariances_ahead_m2,
    position_covariances_m2,
    start_alignment,
)
from wheelsight.evaluation.evaluate import (
    AbsoluteError,
    Evaluation,
    RelativeError,
    ate,
    evaluate,
    frame_coverage,
    pairing_warning,
    rpe,
    time_coverage,
)
from wheelsight.evaluation.statistics import SequenceStatistics, Statistics, sequence_statistics

__all__ = [
    "THREE_SIGMA_RADIUS",
    "AbsoluteError",
    "Consistency",
    "Evaluation",
    "RelativeError",
    "SequenceStatistics",
    "Statistics",
    "ate",
    "consistency",
    "covariances_ahead_m2",
    "evaluate",
    "frame_coverage",
    "pairing_warning",
    "position_covariances_m2",
    "rpe",
    "sequence_statistics",
    "start_alignment",
    "time_coverage",
]
