"""TrackingState: initializing, tracking, failing or lost, for every odometry by a camera (Zhang, Fig. 3)."""

from __future__ import annotations

from dataclasses import dataclass, replace

from wheelsight.estimates import Status

# Of a fresh start: nothing is uncertain about where the map begins, but no covariance may be singular.
START_VARIANCE = 1e-12


@dataclass(frozen=True, slots=True)
class TrackingState:
    """What the frames so far came to.

    Attributes:
        lost_after: so many frames that fail in a row are lost, until a place is recognised.
        has_begun: whether any frame was tracked.
        failures: frames that failed since the last one tracked.
    """

    lost_after: int
    has_begun: bool = False
    failures: int = 0

    @property
    def is_lost(self) -> bool:
        """Whether so many frames failed that only recognising a place helps."""
        return self.has_begun and self.failures >= self.lost_after

    @property
    def status(self) -> Status:
        """For the answer at the last frame."""
        if not self.has_begun:
            return Status.INITIALIZING
        if self.is_lost:
            return Status.LOST
        return Status.FAILING if self.failures else Status.TRACKING

    def tracked(self) -> TrackingState:
        """After a frame whose pose was found."""
        return replace(self, has_begun=True, failures=0)

    def failed(self) -> TrackingState:
        """After one that gave no pose."""
        return replace(self, failures=self.failures + 1)
