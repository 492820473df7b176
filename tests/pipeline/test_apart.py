"""Drives whose localization answers apart: the floor grows by what it shows, and the map is whole at the end."""

from __future__ import annotations

import multiprocessing
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from narrowing import not_none

from wheelsight.app.run.drives import drive_in_map, exploring
from wheelsight.config import Config, load_config
from wheelsight.navigation import NavigationState, Navigator
from wheelsight.slam.maps import MapFolder
from wheelsight_sim import SimulationSettings, Simulator

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]
# Simulated time goes on faster than frames are answered; a robot's does not.
PACE_S = 0.1


def simulator(config: Config) -> Simulator:
    settings = SimulationSettings("studio", size=(160, 120), rate_hz=5, seed=3, realism="real")
    return Simulator(settings, limits=config.navigation.limits)


def led(navigator: Navigator, steps: int, until: NavigationState = NavigationState.ARRIVED) -> None:
    for _ in range(steps):
        if navigator.is_task_complete() or navigator.state is until:
            return
        begin_s = time.monotonic()
        navigator.step()
        time.sleep(max(PACE_S - (time.monotonic() - begin_s), 0.0))


def test_a_map_is_explored_and_driven_in(tmp_path: Path) -> None:
    config = load_config(overrides={"odometry": "wheels,dense", "loops.source": "keyframes"})
    folder = tmp_path / "map"
    with simulator(config) as robot, exploring(robot, config, folder, in_step=False, trusts_floor=True) as drive:
        drive.navigator.explore()
        led(drive.navigator, 250)
        store = not_none(drive.navigator.senses.localization.keyframes)
        seen, free_m2 = len(store), drive.grid.free_m2()
        assert drive.navigator.senses.localization.recognised is None
    assert not multiprocessing.active_children()
    assert seen > 2
    assert free_m2 > 2.0
    with closing(MapFolder.open(folder)) as kept:
        # What was made last comes with the frame after it, which no one waited for.
        assert seen <= len(kept.store) <= seen + 3

    known = load_config(overrides={"odometry": "wheels,dense", "known_map": {"path": str(folder), "start": "0,0,0"}})
    with simulator(known) as robot, drive_in_map(robot, known, in_step=False, trusts_floor=True) as drive:
        T_map_world = np.linalg.inv(robot.T_world_base)
        drive.navigator.go_to_pose((0.6, 0.0))
        led(drive.navigator, 600, NavigationState.DRIVING)
        assert drive.navigator.state is NavigationState.DRIVING
        led(drive.navigator, 60)
        off = not_none(drive.navigator.feedback.pose)[:2] - (T_map_world @ robot.T_world_base)[:2, 3]
        np.testing.assert_allclose(off, 0.0, atol=0.15)
        assert drive.navigator.senses.localization.recognised is not None
        assert not robot.contacts
    assert not multiprocessing.active_children()
