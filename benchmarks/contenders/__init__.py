"""All that takes part. To add a contender: one file beside this one, and its line below."""

from benchmarks.contenders import (
    open3d_odometry,
    open3d_slam,
    opencv_odometry,
    wheelsight_dense,
    wheelsight_features,
)
from benchmarks.contenders.protocol import Contender, Tracker

# Over whole recordings. The targets of feature odometry speak of wheelsight's first.
ALL: tuple[Contender, ...] = (
    wheelsight_features.KEYFRAMES,
    wheelsight_features.PREVIOUS,
    wheelsight_dense.KEYFRAMES,
    wheelsight_dense.SURFELS,
    opencv_odometry.RGB_DEPTH,
    opencv_odometry.REGISTERED,
    open3d_odometry.HYBRID,
    open3d_odometry.REGISTERED,
)

# Of those that build a model of what they see, the peers take too long for whole recordings.
MAPPERS: tuple[Contender, ...] = (wheelsight_dense.SURFELS, open3d_slam.FINE, open3d_slam.COARSE)


def named(name: str) -> Contender:
    """The contender of that name. Raises KeyError."""
    return {contender.name: contender for contender in (*ALL, *MAPPERS)}[name]


__all__ = ["ALL", "MAPPERS", "Contender", "Tracker", "named"]
