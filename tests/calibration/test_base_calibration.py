from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from drives import MIXED
from sighted_drives import MOUNT, NOMINAL, USUAL, nominal, sighted, with_late_camera

from wheelsight.core.errors import CalibrationError
from wheelsight.core.geometry import FloatArray
from wheelsight.core.trajectory import Trajectory
from wheelsight_calibration.base import QUANTITIES, Sightings, base_from, mount_values, refuse_if_hardly_moving
from wheelsight_calibration.wheel_drive import WheelDrive
from wheelsight_sim import RobotModel

ON_THE_SPOT = [(4.0, 0.0, 0.8), (1.0, 0.0, 0.0), (4.0, 0.0, -0.8), (1.0, 0.0, 0.0)] * 3
MOUNTS = {
    "aside": MOUNT,
    "backwards": RobotModel(camera_yaw_rad=3.0, camera_forward_m=-0.2, camera_pitch_rad=0.3).T_base_camera,
    "upside down": RobotModel(camera_roll_rad=np.pi, camera_pitch_rad=0.2).T_base_camera,
    "down": RobotModel(camera_pitch_rad=1.2, camera_height_m=1.3).T_base_camera,
}


@pytest.mark.parametrize("name", ["aside", *(pytest.param(name, marks=pytest.mark.slow) for name in [*MOUNTS][1:])])
def test_mount_and_delay_are_found(rng: np.random.Generator, name: str) -> None:
    """With wheels 2 % off, slips, and a camera 40 ms late, within half a degree, a centimetre and five milliseconds."""
    T_base_camera = MOUNTS[name]
    wheels = replace(NOMINAL, left_radius_m=0.1734, slip_m_per_sqrt_m=0.002)
    seen = sighted(wheels, T_base_camera, MIXED * 2, rng=rng, slips=2, blur=USUAL, camera_late_s=0.04)
    roughly = T_base_camera if name == "upside down" else None
    found = base_from(seen, nominal(roughly))
    expected = mount_values(T_base_camera) | {"delay": -0.04}
    angle = np.radians(0.5)
    limits: dict[str, float] = {"roll": angle, "pitch": angle, "yaw": angle, "x": 0.01, "y": 0.01, "height": 0.01}
    for quantity, limit in (limits | {"delay": 0.005}).items():
        off = found.values[quantity] - expected[quantity]
        off = (off + np.pi) % (2 * np.pi) - np.pi if quantity in ("roll", "pitch", "yaw") else off
        assert abs(off) < limit, (quantity, off)
        sigma = found.sigmas[quantity]
        assert sigma is not None
        assert abs(off) < 4 * sigma, (quantity, off, sigma)
    np.testing.assert_allclose(found.T_base_camera[:3, :3], T_base_camera[:3, :3], atol=0.01)


def test_only_mount_and_delay_are_written_down(rng: np.random.Generator) -> None:
    """Wheel sizes are fitted along, but kept nominal; a robot's cameras are not touched."""
    found = base_from(sighted(replace(NOMINAL, left_radius_m=0.1734), rng=rng, blur=USUAL), nominal())
    written = found.calibration
    assert written.color is None
    assert written.wheels == replace(NOMINAL, delay_s=found.values["delay"])
    assert written.T_base_camera is not None
    np.testing.assert_array_equal(written.T_base_camera, found.T_base_camera)
    assert list(found.values) == list(found.sigmas) == list(QUANTITIES)
    assert found.nominal_values == {"delay": 0.0}
    assert set(base_from(found.sightings, nominal(MOUNT)).nominal_values) == set(QUANTITIES)


def test_a_delay_known_before_is_where_the_search_begins(rng: np.random.Generator) -> None:
    late = replace(NOMINAL, delay_s=1.2)
    seen = sighted(late, rng=rng, blur=USUAL, legs=MIXED * 2)
    known = replace(nominal(), wheels=late)
    assert base_from(seen, known).values["delay"] == pytest.approx(1.2, abs=0.005)


def test_what_the_camera_leaves_open_is_in_sigma_and_reported(rng: np.random.Generator) -> None:
    seen = sighted(rng=rng, blur=USUAL)
    exact, open_ = base_from(seen, nominal(MOUNT)), base_from(seen, replace(nominal(MOUNT), point_errors=None))
    assert not exact.warnings
    assert set(exact.camera_sigmas.values()) == {0.0}
    (warning,) = open_.warnings
    assert "wheelsight calibrate camera" in warning
    assert f"{1e3 * max(open_.camera_sigmas[name] for name in ('x', 'y', 'height')):.0f} mm" in warning
    for name in QUANTITIES[:-1]:
        assert open_.values[name] == exact.values[name]
        assert open_.sigmas[name] == pytest.approx(np.hypot(exact.sigmas[name], open_.camera_sigmas[name]))
        assert open_.camera_sigmas[name] > 3 * exact.sigmas[name]


def test_a_mount_far_from_nominal_is_doubted(rng: np.random.Generator) -> None:
    """Wheels that both count backwards cannot be distinguished from a camera that looks back."""
    looks_back = RobotModel(camera_yaw_rad=3.0).T_base_camera
    assert not base_from(sighted(rng=rng, blur=USUAL), nominal(MOUNT)).warnings
    (doubt,) = base_from(sighted(rng=rng, blur=USUAL), nominal(looks_back)).warnings
    assert "the wheels may count backwards" in doubt


@pytest.mark.parametrize(
    ("legs", "reported"),
    [
        ([(20.0, 0.0, 0.0)], r"by its wheels the robot stands, it goes 0.00 m .drive a minute or two"),
        ([(20.0, 0.8, 0.0)], r"hardly turns, by \d° in all: x and y of the camera stay unseen .drive some turns too"),
        ([(20.0, 0.8, 0.04)], r"hardly turns, by 4\d°"),
        (ON_THE_SPOT, r"hardly leaves its place, .* where the camera looks stays unseen .drive straight"),
    ],
    ids=["standing", "straight", "bend", "on-the-spot"],
)
def test_drives_that_cannot_show_it_are_refused_by_their_wheels(
    legs: list[tuple[float, float, float]], reported: str
) -> None:
    with pytest.raises(CalibrationError, match=reported):
        refuse_if_hardly_moving(sighted(legs=legs).drive, NOMINAL)


def lost(seen: Sightings) -> Sightings:
    return replace(seen, camera=seen.camera.select(slice(0, len(seen.camera) // 3)))


def swapped(seen: Sightings) -> Sightings:
    drive = seen.drive
    return replace(seen, drive=WheelDrive(drive.stamps_s, drive.right_rad, drive.left_rad))


def halved(seen: Sightings) -> Sightings:
    T = seen.camera.T_frame_body.copy()
    T[:, :3, 3] /= 2
    return replace(seen, camera=Trajectory(seen.camera.stamps_s, T))


def unlike(seen: Sightings) -> Sightings:
    other = sighted(legs=[(1.0 + 0.37 * n % 2.3, 0.5, 0.9 * (-1) ** (n * n // 3)) for n in range(25)])
    return replace(seen, drive=other.drive)


@pytest.mark.parametrize(
    ("change", "reported"),
    [
        (lost, r"the camera could be followed in \d+ of \d+ frames only .drive slowly"),
        (swapped, r"the camera turns left where the wheels turn right .swap left and right wheel"),
        (halved, r"distances by the camera are 0.50 times those by the wheels .check the depth factor"),
        (unlike, r"wheels and camera do not turn together"),
        (lambda seen: with_late_camera(seen, 1.7e9), r"share 0.0 s: their clocks count from different moments"),
        (lambda seen: with_late_camera(seen, -900.0), r"their clocks count from different moments"),
        (lambda seen: with_late_camera(seen, -3.0), r"stamps seem \+3.00 s late, .* .give wheels.delay_s: 3.00"),
    ],
    ids=["lost", "swapped", "wrong-depth", "other-drive", "other-epoch", "no-overlap", "seconds-apart"],
)
def test_sightings_that_do_not_fit_are_refused(
    rng: np.random.Generator, change: Callable[[Sightings], Sightings], reported: str
) -> None:
    with pytest.raises(CalibrationError, match=reported):
        base_from(change(sighted(rng=rng, blur=USUAL)), nominal())


@pytest.mark.parametrize(
    ("T_base_camera", "reported"),
    [
        (RobotModel(camera_pitch_rad=-0.7).T_base_camera, "no floor is in view|show enough floor"),
        (RobotModel(camera_pitch_rad=0.02, camera_height_m=2.9).T_base_camera, "no floor is in view|show enough floor"),
    ],
    ids=["looks-up", "hangs-high"],
)
def test_a_camera_that_sees_no_floor_is_refused(T_base_camera: FloatArray, reported: str) -> None:
    with pytest.raises(CalibrationError, match=reported) as refused:
        base_from(sighted(T_base_camera=T_base_camera), nominal())
    assert "tilt the camera down" in str(refused.value)


def test_a_circle_at_one_speed_is_refused(rng: np.random.Generator) -> None:
    """All its pieces are alike: they show neither which way the camera looks nor the delay."""
    seen = sighted(legs=[(40.0, 0.5, 0.5)], rng=rng, blur=USUAL)
    with pytest.raises(CalibrationError, match=r"the drive does not determine: .* .*turns one way only") as refused:
        base_from(seen, nominal())
    assert re.search(r"\(σ [\d.]+(e\+\d+)? ?(°|cm|ms)\)", str(refused.value))


def test_frames_that_never_came_are_refused(rng: np.random.Generator) -> None:
    seen = sighted(rng=rng, blur=USUAL)
    empty = replace(seen, camera=seen.camera.select(slice(0, 0)), frame_count=0, span_s=(np.nan, np.nan))
    with pytest.raises(CalibrationError, match="followed in 0 of 0 frames"):
        base_from(empty, nominal())
