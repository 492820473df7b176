"""Keypoints beside surfaces, where they say less than a pose needs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from odometry.dense.scenes import dense
from odometry.views import room_frame
from synthetic import wobbling_trajectory

from wheelsight.core.estimates import Status
from wheelsight.vision.dense.tracking import KeypointTracker
from wheelsight.vision.features.tracking import Fix, MapTracker, ViewTracker

TRUTH = wobbling_trajectory(6)


@pytest.mark.parametrize("value", [0.0, np.nan])
def test_keypoints_that_do_not_tell_how_sure_they_are_tell_no_pose(
    monkeypatch: pytest.MonkeyPatch, value: float
) -> None:
    """Rounding may leave a direction with no variance at all; a chi-square by that would end the drive."""
    asked, reported = ViewTracker.track, KeypointTracker.track
    answers = []

    def unsure(*arguments: object) -> object:
        found = asked(*arguments)  # type: ignore[arg-type]
        if not isinstance(found, Fix):
            return found
        flat = np.diag([1e-6, 1e-6, 1e-6, 1e-6, 1e-6, value])
        view = replace(found.view, covariance=np.zeros((6, 6)))
        return replace(found, motion=replace(found.motion, covariance=flat), view=view)

    def watched(*arguments: object) -> object:
        answers.append(reported(*arguments))  # type: ignore[arg-type]
        return answers[-1]

    monkeypatch.setattr(ViewTracker, "track", unsure)
    monkeypatch.setattr(MapTracker, "track", lambda *_: None)
    monkeypatch.setattr(KeypointTracker, "track", watched)
    subject = dense()
    statuses = [subject.process(room_frame(T, stamp_s)).status for stamp_s, T in TRUTH]
    assert len(answers) >= 4
    assert set(answers) == {None}
    assert statuses[0] is Status.TRACKING
