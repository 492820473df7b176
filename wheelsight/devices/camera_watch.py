"""CameraWatch: what has changed with a live camera since the last look, in sentences for a person."""

from __future__ import annotations

from wheelsight.devices.live_camera import CameraReport, CameraStatus, LiveCamera

GONE = (CameraStatus.STALLED, CameraStatus.UNPLUGGED, CameraStatus.ENDED)


class CameraWatch:
    """Looks at a camera again and again; one that starts and streams goes without saying."""

    def __init__(self, camera: LiveCamera) -> None:
        self._camera = camera
        self._before: CameraReport | None = None

    def changes(self) -> list[str]:
        """Since the last call, each with the camera's name before it."""
        before, now = self._before, self._camera.report()
        self._before = now
        return [f"{self._camera.name}: {text}" for text in _changes(before, now)]


def _changes(before: CameraReport | None, now: CameraReport) -> list[str]:
    if before is None:
        return [_told(now)] if now.status in GONE else []
    told = []
    if now.status is not before.status and now.status in GONE:
        told.append(_told(now))
    elif before.status in GONE and now.status is CameraStatus.STREAMING:
        told.append("is back")
    if now.clock_jumps > before.clock_jumps:
        told.append("its clock leapt; its stamps are mapped anew")
    return told


def _told(report: CameraReport) -> str:
    return f"{report.status}{f' ({report.detail})' if report.detail else ''}"
