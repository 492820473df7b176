from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest
from simulation.planes import WALL, plane

from wheelsight.core.errors import ConfigError
from wheelsight_sim.robot import RobotModel
from wheelsight_sim.wheelchair import PREFIX, ROLLING, scene, wheelchair_mjcf

UNEVEN = RobotModel(left_radius_m=0.171, right_radius_m=0.168, track_width_m=0.53)


def settled(robot: RobotModel) -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = scene(plane(), robot)
    model.geom(PREFIX + "jack").pos[2] += 0.02
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 400)
    return model, data


@pytest.mark.parametrize("robot", [RobotModel(), UNEVEN], ids=["nominal", "uneven"])
def test_the_driven_wheels_touch_the_ground_at_the_ends_of_the_track(robot: RobotModel) -> None:
    model, data = settled(robot)
    touches = {int(contact.geom[1]): contact.pos for contact in data.contact}
    assert sorted(touches) == sorted(model.geom(PREFIX + name).id for name in ROLLING)
    for name, sense in (("left_wheel", 1), ("right_wheel", -1)):
        touch = touches[model.geom(PREFIX + name).id]
        np.testing.assert_allclose(touch, [0, sense * robot.track_width_m / 2, 0], atol=1e-4)


@pytest.mark.parametrize("robot", [RobotModel(), UNEVEN], ids=["nominal", "uneven"])
def test_load_takes_less_than_a_five_thousandth_off_the_radius(robot: RobotModel) -> None:
    _, data = settled(robot)
    for name, radius_m in (("left_wheel", robot.left_radius_m), ("right_wheel", robot.right_radius_m)):
        height_m = data.geom(PREFIX + name).xpos[2]
        # MuJoCo's point of contact lies half-way into the overlap.
        assert height_m + (radius_m - height_m) / 2 == pytest.approx(radius_m, rel=2e-4)
        assert height_m < radius_m


def test_the_base_stands_level_on_the_floor() -> None:
    _, data = settled(UNEVEN)
    T = data.body(PREFIX + "base")
    np.testing.assert_allclose(T.xmat.reshape(3, 3), np.eye(3), atol=1e-3)
    assert T.xpos[2] == pytest.approx(0, abs=1e-5)


def test_a_person_and_a_chair_weigh_what_they_do_and_load_the_driven_wheels_more() -> None:
    model, data = settled(RobotModel())
    assert model.body_mass.sum() == pytest.approx(130)
    loads = {int(contact.geom[1]): data.efc_force[contact.efc_address] for contact in data.contact}
    driven, castors = (
        sum(loads[model.geom(PREFIX + name).id] for name in names) for names in (ROLLING[:2], ROLLING[2:])
    )
    assert driven + castors == pytest.approx(130 * 9.81, rel=1e-3)
    assert 0.55 < driven / (driven + castors) < 0.75


def test_the_hull_is_the_papers_box() -> None:
    model = scene(plane(), RobotModel())
    hull = model.geom(PREFIX + "hull")
    np.testing.assert_allclose(2 * hull.size[:2], [1.10, 0.60])
    assert hull.pos[2] + hull.size[2] == pytest.approx(1.00)
    assert hull.pos[2] - hull.size[2] > 0


def test_only_what_can_be_bumped_into_is_kept_of_a_world() -> None:
    poster = '<geom name="poster" type="box" pos="2 0 1" size="0.01 0.5 0.5" contype="0"/>'
    names = {scene(plane(extra=WALL + poster), RobotModel()).geom(i).name for i in range(3)}
    assert "wall" in names
    assert "poster" not in names


def test_mujocos_viewer_could_open_the_wheelchair_alone() -> None:
    model = mujoco.MjModel.from_xml_string(wheelchair_mjcf(RobotModel()))
    assert model.nu == 2
    assert math.isclose(model.body_mass.sum(), 130)


def test_a_world_that_is_no_mjcf_is_refused_in_one_line() -> None:
    with pytest.raises(ConfigError, match="world 'plane' with its robot") as refusal:
        scene(replace(plane(), mjcf="<mujoco><worldbody><geom type='lump'/></worldbody></mujoco>"), RobotModel())
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("left_radius_m", 0.0),
        ("right_radius_m", -0.17),
        ("left_radius_m", math.nan),
        ("left_radius_m", 0.01),
        ("right_radius_m", 0.6),
        ("track_width_m", math.inf),
        ("track_width_m", 0.05),
        ("track_width_m", 2.5),
        ("gear_ratio", 0.0),
        ("counts_per_turn", -100),
        ("counts_per_turn", 100.5),
        ("length_m", 0.2),
        ("width_m", math.nan),
        ("height_m", 0.0),
    ],
)
def test_wheels_that_no_wheelchair_has_are_refused(name: str, value: Any) -> None:
    with pytest.raises(ConfigError, match=name):
        RobotModel(**{name: value})
