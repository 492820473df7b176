"""How many events a run's progress counts to."""

from __future__ import annotations

import pytest
from pipeline.live import Live
from pipeline.made import BOTH
from synthetic import wobbling_trajectory

from wheelsight.app.cli.run import expected
from wheelsight.config import Config


@pytest.mark.parametrize(("settings", "unit"), [(Config(), "frames"), (BOTH, "events")])
def test_progress_has_no_total(settings: Config, unit: str) -> None:
    assert expected(Live(wobbling_trajectory(8)), settings) == (None, unit)
