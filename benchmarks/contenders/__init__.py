"""All that takes part. To add a contender: one file beside this one, and its line below."""

from benchmarks.contenders import open3d_odometry, opencv_odometry, wheelsight_features
from benchmarks.contenders.protocol import Contender, Tracker

# wheelsight's first contender is the one the targets speak of.
ALL: tuple[Contender, ...] = (
    wheelsight_features.KEYFRAMES,
    wheelsight_features.PREVIOUS,
    opencv_odometry.RGB_DEPTH,
    opencv_odometry.REGISTERED,
    open3d_odometry.HYBRID,
    open3d_odometry.REGISTERED,
)


def named(name: str) -> Contender:
    """The contender of that name. Raises KeyError."""
    return {contender.name: contender for contender in ALL}[name]


__all__ = ["ALL", "Contender", "Tracker", "named"]
