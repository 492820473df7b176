"""What `write_simulation` leaves on the disk: whole, shorter, or refused."""

from __future__ import annotations

import filecmp
import sys
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import yaml
from full_disk import FullDisk
from narrowing import as_frame, not_none

from wheelsight.core.areas import load_areas
from wheelsight.core.calibration import load_calibration
from wheelsight.core.errors import ConfigError, InputError, OutputError
from wheelsight.core.geometry import se3
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.trajectory import read_tum
from wheelsight.io.recordings import open_recording
from wheelsight_sim import Patch, RobotModel, SimulationSettings, WheelFaults, simulate, write_simulation
from wheelsight_sim.physics import driver_of, refuse_walls
from wheelsight_sim.worlds import build_world

ROBOT = RobotModel(right_radius_m=0.172, camera_height_m=0.93, has_gyro=True)
SETTINGS = SimulationSettings(world="floor4", size=(64, 48), rate_hz=10.0, duration_s=1.0, seed=2, robot=ROBOT)


@pytest.fixture(scope="module")
def recording():
    return simulate(SETTINGS)


@pytest.fixture(scope="module")
def folder(recording, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("simulated") / "floor"
    write_simulation(recording, folder)
    return folder


def files_in(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


def write_table(path: Path, rows: str) -> Path:
    path.write_text(f"stamp_s,v_m_s,yaw_rate_rad_s\n{rows}")
    return path


def test_it_reads_back_as_it_was(recording, folder):
    read = open_recording(folder)
    assert (read.format, read.body, read.warnings) == ("wheelsight", "base", ())
    for got, wanted in zip(read.events(), recording.events(), strict=True):
        if isinstance(wanted, RgbdFrame):
            read_back = as_frame(got)
            assert (read_back.stamp_s, read_back.index) == (wanted.stamp_s, wanted.index)
            np.testing.assert_array_equal(read_back.color, wanted.color)
            np.testing.assert_allclose(read_back.depth_m, wanted.depth_m, atol=0.5001 / 5000)
        else:
            assert got == wanted
    assert read.calibration.wheels == recording.calibration.wheels
    np.testing.assert_allclose(not_none(read.ground_truth).T_frame_body, recording.ground_truth.T_frame_body, atol=1e-8)


def test_truth_holds_for_the_robot_as_it_is(folder):
    base, camera = read_tum(folder / "groundtruth_base.txt", "base"), read_tum(folder / "groundtruth.txt")
    assert (base.body, camera.body) == ("base", "camera")
    np.testing.assert_array_equal(base.stamps_s, camera.stamps_s)
    np.testing.assert_allclose(camera.T_frame_body, base.T_frame_body @ ROBOT.T_base_camera, atol=1e-8)
    true = load_calibration(folder / "truth" / "calibration.yaml")
    assert true.wheels == ROBOT.wheels
    np.testing.assert_allclose(se3.log(not_none(true.T_base_camera) @ se3.invert(ROBOT.T_base_camera)), 0, atol=1e-12)


@pytest.mark.slow
def test_a_real_drive_is_repeated_to_the_byte_and_shows_where_the_camera_was(tmp_path):
    settings = replace(SETTINGS, realism="real")
    recording = simulate(settings)
    for name in ("one", "two"):
        write_simulation(recording if name == "one" else simulate(settings), tmp_path / name)
    names = files_in(tmp_path / "one")
    _, differ, missing = filecmp.cmpfiles(tmp_path / "one", tmp_path / "two", names, shallow=False)
    assert (differ, missing) == ([], [])
    read = open_recording(tmp_path / "one")
    frames = [event for event in read.events() if isinstance(event, RgbdFrame)]
    assert [frame.stamp_s for frame in frames] == [recording.renderer.stamp_s(k) for k in range(len(frames))]
    camera = read_tum(tmp_path / "one" / "groundtruth.txt")
    expected = recording.renderer.carriage.T_world_camera(camera.stamps_s)
    np.testing.assert_allclose(camera.T_frame_body, expected, atol=1e-8)
    true = load_calibration(tmp_path / "one" / "truth" / "calibration.yaml")
    off = se3.log(se3.invert(not_none(read.calibration.T_base_camera)) @ not_none(true.T_base_camera))
    off -= se3.log(se3.invert(RobotModel().T_base_camera) @ ROBOT.T_base_camera)
    assert 1e-4 < np.linalg.norm(off[:3]) < 0.02
    assert 1e-4 < np.linalg.norm(off[3:]) < 0.02
    assert true.color != read.calibration.color


def test_each_frame_has_its_area(recording, folder):
    header, *rows = (folder / "labels.csv").read_text().splitlines()
    assert header == "stamp_s,area"
    areas, base = load_areas(folder / "areas.yaml"), read_tum(folder / "groundtruth_base.txt", "base")
    frames = [event for event in recording.events() if isinstance(event, RgbdFrame)]
    assert len(rows) == len(frames)
    for row, frame in zip(rows, frames, strict=True):
        stamp, area = row.split(",")
        assert float(stamp) == frame.stamp_s
        assert area == areas.name_at(*base.at(frame.stamp_s)[0, :2, 3])


def test_all_that_is_needed_to_repeat_it_is_there(folder):
    reported = yaml.safe_load((folder / "truth" / "settings.yaml").read_text())
    given = reported["settings"]
    robot, faults, size = RobotModel(**given.pop("robot")), WheelFaults(**given.pop("faults")), tuple(given.pop("size"))
    assert robot == ROBOT
    assert not any((faults.dropouts_s, faults.patches, given.pop("covered_s")))
    assert SimulationSettings(**given, size=size, robot=robot) == SETTINGS
    assert {"wheelsight", "mujoco", "numpy"} <= set(reported["versions"])
    model = mujoco.MjModel.from_xml_path(str(folder / "truth" / "world.xml"))
    assert model.ngeom > 100


def test_the_same_seed_leaves_the_same_bytes(folder, tmp_path):
    write_simulation(simulate(SETTINGS), tmp_path / "again")
    names = files_in(folder)
    assert names == files_in(tmp_path / "again")
    assert {"plan.png", "truth/world.xml", "groundtruth.txt", "rgb/0.100000.png"} <= set(names)
    _, differ, missing = filecmp.cmpfiles(folder, tmp_path / "again", names, shallow=False)
    assert (differ, missing) == ([], [])


@pytest.mark.parametrize("frames", [1, 4])
def test_ctrl_c_leaves_a_shorter_recording(recording, tmp_path, frames):
    def stop(frame: RgbdFrame) -> None:
        if frame.index == frames - 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_simulation(recording, tmp_path / "cut", on_frame=stop)
    check_shorter(tmp_path / "cut", recording, frames)


@pytest.mark.parametrize(("full", "room"), [("depth.txt", 250), ("groundtruth.txt", 3000), ("labels.csv", 70)])
def test_a_full_disk_leaves_a_shorter_recording(recording, tmp_path, monkeypatch, full, room):
    FullDisk(full, room).take_over(monkeypatch)
    with pytest.raises(OutputError, match=f"{full}: no space left on the disk"):
        write_simulation(recording, tmp_path / "cut")
    monkeypatch.undo()
    check_shorter(tmp_path / "cut", recording, None)


def check_shorter(folder: Path, whole, frames: int | None) -> None:
    """A sound recording of the first `frames`, or where that is None of some, with their truth and labels."""
    read = open_recording(folder)
    if frames is None:
        frames = read.frame_count
        assert 0 < frames < whole.frame_count
    events = list(read.events())
    kept = [event for event in events if isinstance(event, RgbdFrame)]
    assert len(kept) == read.frame_count == frames
    for got, wanted in zip(events, whole.events(), strict=False):
        assert type(got) is type(wanted)
        assert got.stamp_s == wanted.stamp_s
    assert not_none(read.ground_truth).stamps_s[-1] >= kept[-1].stamp_s
    assert not_none(read.ground_truth).stamps_s[-1] < whole.ground_truth.stamps_s[-1]
    assert len((folder / "labels.csv").read_text().splitlines()) >= frames + 1


def test_a_used_folder_is_refused(recording, folder):
    with pytest.raises(OutputError, match="--force"):
        write_simulation(recording, folder)


def test_velocities_are_kept_with_the_recording(tmp_path):
    table = write_table(tmp_path / "v.csv", "0,0.5,0\n1,0.5,0.3\n2,0,0\n")
    settings = replace(SETTINGS, velocities=table, duration_s=None, world="square")
    recording = simulate(settings)
    assert recording.ground_truth.duration_s == pytest.approx(2.0, abs=0.03)
    write_simulation(recording, tmp_path / "out")
    assert (tmp_path / "out" / "truth" / "velocities.csv").read_bytes() == table.read_bytes()
    assert not (tmp_path / "out" / "areas.yaml").exists()


def test_a_way_through_a_wall_is_refused_with_a_picture(tmp_path):
    table = write_table(tmp_path / "v.csv", "0,1,0\n60,0,0\n")
    picture = tmp_path / "refused.png"
    with pytest.raises(ConfigError, match=r"v.csv: the way .*runs into .* at x = .* \(see .*refused.png\)"):
        simulate(replace(SETTINGS, velocities=table, duration_s=None), refused=picture)
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_velocities_that_cannot_be_read_are_named(tmp_path):
    table = write_table(tmp_path / "v.csv", "0,fast,0\n60,0,0\n")
    with pytest.raises(InputError, match=r"v.csv:2: v_m_s is 'fast', not a number"):
        simulate(replace(SETTINGS, velocities=table))


def test_a_route_can_be_driven_the_other_way_round():
    ahead, back = (simulate(replace(SETTINGS, is_reverse=is_reverse, duration_s=4.0)) for is_reverse in (False, True))
    start, end = (ahead.ground_truth.positions_m[i, :2] for i in (0, -1))
    np.testing.assert_allclose(back.ground_truth.positions_m[0, :2], start, atol=1e-3)
    assert (end - start) @ (back.ground_truth.positions_m[-1, :2] - start) < 0


@pytest.mark.parametrize(("track_width_m", "least_m", "most_m"), [(0.52, 0.0, 0.02), (0.54, 0.03, 0.3)])
def test_stopping_to_turn_drives_the_square_as_the_wheels_have_it(track_width_m, least_m, most_m):
    robot = RobotModel(track_width_m=track_width_m)
    settings = replace(SETTINGS, world="square", robot=robot, stops_to_turn=True, has_slip=False, duration_s=12.0)
    recording = simulate(settings)
    first, second, third = recording.world.route[:3]
    xy = recording.ground_truth.positions_m[:, :2]
    off_m = np.minimum(*(_distance_m(xy, *leg) for leg in ((first, second), (second, third))))
    assert least_m <= off_m.max() < most_m


def test_a_way_too_near_to_a_wall_to_turn_is_refused():
    world = build_world("square", 1)
    for gap_m, is_refused in ((0.45, False), (0.35, True)):
        y = -2.5 + gap_m
        beside = replace(world, route=np.array([(-0.5, y), (0.5, y)]), is_loop=False)
        settings = replace(SETTINGS, world="square", robot=RobotModel())
        with pytest.raises(ConfigError, match="runs into wall_south") if is_refused else nullcontext():
            refuse_walls(settings, beside, driver_of(settings, beside), None)


def _distance_m(xy, start, end):
    along = (end - start) / np.linalg.norm(end - start)
    return np.abs((xy - start) @ [-along[1], along[0]])


def test_progress_shows_how_far_of_how_much():
    reported = []
    simulate(replace(SETTINGS, duration_s=3.0), lambda done_s, of_s: reported.append((done_s, of_s)))
    assert reported == [(0.0, 3.0), (1.0, 3.0), (2.0, 3.0), (3.0, 3.0)]


def test_without_mujoco_the_way_to_it_is_reported(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ConfigError, match=r"^MuJoCo is missing \(pip install mujoco matplotlib\)"):
        simulate(SETTINGS)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"laps": 0}, "--laps is 0"),
        ({"seed": -1}, "--seed is -1"),
        ({"passersby": -1}, "--passers-by is -1"),
        ({"speed_m_s": 1.3}, r"--speed is 1.3 m/s \(over 0, up to 1.2 m/s\)"),
        ({"speed_m_s": np.nan}, "--speed is nan"),
        ({"rate_hz": 0.0}, "--rate is 0 Hz"),
        ({"duration_s": -1.0}, "--duration is -1 s"),
        ({"size": (8, 48)}, "--size is 8x48"),
        ({"velocities": Path("v.csv"), "laps": 2}, "--drive has no route"),
    ],
)
def test_settings_out_of_range_name_their_option(change, problem):
    with pytest.raises(ConfigError, match=problem):
        replace(SETTINGS, **change)


def test_faults_are_reported_in_the_settings():
    faults = WheelFaults(dropouts_s=((1.0, 2.5),), patches=(Patch(1.0, 2.0, 0.5),))
    plain = replace(SETTINGS, faults=faults).to_dict()
    assert plain["faults"]["dropouts_s"] == [[1.0, 2.5]]
    assert plain["faults"]["patches"] == [{"x_m": 1.0, "y_m": 2.0, "radius_m": 0.5, "friction": 0.05}]
    assert yaml.safe_load(yaml.safe_dump(plain)) == plain


@pytest.mark.parametrize(
    ("mishap", "reported"),
    [
        ({"covered_s": ((1000, 1010),)}, "--cover 1000:1010 never comes: the drive ends at 2.0 s"),
        ({"faults": WheelFaults(lifted_s=((1, 2), (3, 4)))}, "--lift 3:4 never comes"),
        ({"faults": WheelFaults(dropouts_s=((2, 4),))}, "--dropout 2:4 never comes"),
    ],
)
def test_what_never_comes_is_refused(mishap: dict[str, Any], reported: str) -> None:
    with pytest.raises(ConfigError, match=reported):
        simulate(SimulationSettings(world="square", duration_s=2.0, **mishap))
