"""FusedEstimate: what the default filter answers."""

from __future__ import annotations

from dataclasses import dataclass

from wheelsight.estimates import Estimate
from wheelsight.geometry import FloatArray

# Name of the remembered pose since which motions in `odom` are told. Nothing may be measured against it.
STEP_BEGIN = "step begin"


@dataclass(frozen=True, slots=True, eq=False)
class FusedEstimate(Estimate):
    """The base's pose by all sensors.

    Status: initializing, before any event. tracking: vision was believed within `coast_after_s`. coasting: the wheels
    alone lead, and the covariance grows. lost: nothing was heard for `lost_after_s`, and no measurement against a
    remembered pose has told where the base is since (a position does not tell the heading); there is no pose.

    Attributes:
        slip: the wheels are not believed, because camera or gyroscope contradict them.
        degenerate: the last measurement of the camera did not show all directions.
        doubtful: camera and wheels contradict each other and who is right is not settled; the covariance covers both.
        twist: (3,) vx, vy, ωz of the base in its own frame, m/s and rad/s. Or None.
        twist_covariance: (3, 3), or None.
        nis: normalised innovation squared of the measurement that is answered, and its degrees of freedom; or None.
        wheel_errors: (3,) what is thought to be wrong with the wheels: the ratio by which ways are too short, the turn
            a metre that is missing in rad/m, the ratio by which turns are too small. Or None.
    """

    slip: bool = False
    degenerate: bool = False
    doubtful: bool = False
    twist: FloatArray | None = None
    twist_covariance: FloatArray | None = None
    nis: tuple[float, int] | None = None
    wheel_errors: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FrameUpdate:
    """What came of a frame.

    Attributes:
        answer: to it.
        T_odom_base: (4, 4) when its image was taken, by all that is known; None where nothing is remembered.
        is_reference: whether the camera's next motions are told against it.
    """

    answer: FusedEstimate
    T_odom_base: FloatArray | None
    is_reference: bool

    @property
    def is_believed(self) -> bool:
        """Whether wheels and camera agree on it."""
        return self.answer.reason is None and not self.answer.doubtful
