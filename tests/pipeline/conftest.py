"""What tests of the pipeline share: a true path, and odometry that follows it exactly."""

from __future__ import annotations

import pytest
from stand_ins import TrueOdometry, leave_pages_bare
from synthetic import wobbling_trajectory

from wheelsight.core.trajectory import Trajectory


@pytest.fixture
def truth() -> Trajectory:
    return wobbling_trajectory(20)


@pytest.fixture(autouse=True)
def true_odometry(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, truth: Trajectory) -> None:
    if "real_odometry" not in request.fixturenames:
        TrueOdometry.truth = truth
        monkeypatch.setattr("wheelsight.estimation.camera_localizer.FeatureOdometry", TrueOdometry)


@pytest.fixture
def real_odometry() -> None:
    """Asked for by tests that want no stand-in."""


@pytest.fixture(autouse=True)
def bare_pages(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    if "drawn_pages" not in request.fixturenames:
        leave_pages_bare(monkeypatch)


@pytest.fixture
def drawn_pages() -> None:
    """Asked for by tests that look into the page of a run."""
