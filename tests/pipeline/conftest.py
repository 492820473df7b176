"""What tests of the pipeline share: a true path, and odometry that follows it exactly."""

from __future__ import annotations

import pytest
from stand_ins import TrueOdometry
from synthetic import wobbling_trajectory

from wheelsight.trajectory import Trajectory


@pytest.fixture
def truth() -> Trajectory:
    return wobbling_trajectory(20)


@pytest.fixture(autouse=True)
def true_odometry(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, truth: Trajectory) -> None:
    if "real_odometry" not in request.fixturenames:
        TrueOdometry.truth = truth
        monkeypatch.setattr("wheelsight.localizer._camera.FeatureOdometry", TrueOdometry)


@pytest.fixture
def real_odometry() -> None:
    """Asked for by tests that want no stand-in."""
