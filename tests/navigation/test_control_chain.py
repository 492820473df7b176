"""Controller, ramp and collision monitor one after another, with the chair's camera: they arrive together."""

from __future__ import annotations

import pytest
from grids import mostly_slow
from navigation.test_controllers import WAYS
from navigation.unicycle import CHAIR, NOBODY, Camera, centres_of, clearance_m, field_of

from benchmarks.plain_rooms import Unicycle
from wheelsight.core.estimates import Status
from wheelsight.navigation import CollisionMonitor, ControlReason, MonitorState, MppiController, VelocityRamp


@pytest.mark.parametrize(
    "name", mostly_slow(["straight", "a narrow door", "a corridor", "a sharp corner"], quick=["a narrow door"])
)
def test_a_monitor_lets_a_controller_arrive(name: str) -> None:
    cells, path = WAYS[name]
    points, field = centres_of(cells), field_of(cells)
    x, y, yaw = map(float, path.poses[0])
    base, camera, controller = Unicycle((x, y, yaw)), Camera(), MppiController(CHAIR)
    ramp, monitor, reason = VelocityRamp(), CollisionMonitor(CHAIR), None
    for n in range(800):
        now_s = 0.05 * n
        monitor.add_reading(now_s, base.forward_m_s, base.turn_rad_s)
        if n % 2 == 0:
            monitor.add_view(camera.view(points, base.pose, now_s))
        asked = controller.command(base.state, path, field, NOBODY)
        reason = asked.reason
        if reason is not None and base.stands:
            break
        ramped = ramp.step(asked.command.forward_m_s, asked.command.turn_rad_s, 0.05)
        checked = monitor.check(ramped, now_s, Status.TRACKING)
        if checked.state is not MonitorState.FREE:
            ramp.follow(checked.command)
        base.step(checked.command)
        assert n % 5 or clearance_m(CHAIR, base.pose, points) > 0.025
    assert reason is ControlReason.ARRIVED
