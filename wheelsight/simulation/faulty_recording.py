"""A simulated recording whose camera fails on the way."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, fields

import numpy as np

from wheelsight.events import Event, RgbdFrame
from wheelsight.recordings import AssociationReport
from wheelsight.simulation.camera_faults import CameraFault, events_with
from wheelsight.simulation.simulated_recording import SimulatedRecording


@dataclass(frozen=True, eq=False)
class FaultyRecording(SimulatedRecording):
    """A `SimulatedRecording` seen through camera faults; truth and wheel readings are the same.

    Attributes:
        camera_faults: the first acts first.
    """

    camera_faults: tuple[CameraFault, ...] = ()

    @property
    def frame_count(self) -> int:
        """How many frames are left."""
        blank = np.zeros((2, 2, 3), np.uint8), np.zeros((2, 2), np.float32)
        stamps_s = (self.renderer.stamp_s(index) for index in range(self.renderer.frame_count))
        frames = (RgbdFrame(stamp_s, *blank, index) for index, stamp_s in enumerate(stamps_s))
        return sum(1 for _ in events_with(self.camera_faults, frames))

    @property
    def association(self) -> AssociationReport:
        """Each colour image that is left has its depth image, of the same moment."""
        count = self.frame_count
        return AssociationReport(count, count, count, 0.0)

    def events(self, *, images: bool = True) -> Generator[Event]:
        """Readings and frames (unless without `images`) in order of time, as they come with the faults."""
        events = super().events(images=images)
        try:
            yield from events_with(self.camera_faults, events)
        finally:
            events.close()


def with_camera_faults(recording: SimulatedRecording, *faults: CameraFault) -> FaultyRecording:
    """The same drive with a camera that fails."""
    made_of = {field.name: getattr(recording, field.name) for field in fields(SimulatedRecording)}
    return FaultyRecording(**made_of, camera_faults=faults)
