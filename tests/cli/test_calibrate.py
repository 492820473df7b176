from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from browser import open_page
from drives import simulate, square_legs, write_recording
from typer.testing import Result

from wheelsight.core.calibration import Calibration, load_calibration, save_calibration
from wheelsight.core.calibration_parts import Gyro, Wheels
from wheelsight.core.geometry import PinholeCamera
from wheelsight.core.trajectory import Trajectory, read_tum, write_tum
from wheelsight_calibration.squares import corrected

Command = Callable[..., Result]
Refusal = Callable[..., str]

NOMINAL = Wheels(left_radius_m=0.17, right_radius_m=0.17, track_width_m=0.58, ticks_per_turn=3200)
TRUE = replace(NOMINAL, left_radius_m=0.171, right_radius_m=0.1695, track_width_m=0.615, delay_s=0.06)
MOUNT = np.array([[0.0, 0.0, 1.0, 0.3], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 1.1], [0.0, 0.0, 0.0, 1.0]])
SQUARE = replace(corrected(NOMINAL, 1.006, 1.02), slip_m_per_sqrt_m=0.001)


@pytest.fixture
def drive(tmp_path: Path, rng: np.random.Generator) -> Path:
    simulated = simulate(replace(TRUE, slip_m_per_sqrt_m=0.002), rng=rng, slips=4, reference_sigma_m=0.002)
    write_recording(tmp_path / "drive", NOMINAL, simulated)
    return tmp_path / "drive"


@pytest.fixture
def squares(tmp_path: Path, rng: np.random.Generator) -> list[Path]:
    folders = [tmp_path / f"square{number}" for number in range(4)]
    for folder, sense in zip(folders, (-1, 1, -1, 1), strict=True):
        simulated = simulate(SQUARE, square_legs(NOMINAL, SQUARE, sense), rng=rng)
        write_recording(folder, NOMINAL, simulated, simulated.truth.select([0, -1]))
    return folders


def wheels_in(path: Path) -> Wheels:
    wheels = load_calibration(path).wheels
    assert wheels is not None
    return wheels


def test_a_drive_gives_a_calibration_and_a_page(wheelsight: Command, drive: Path, tmp_path: Path) -> None:
    out = tmp_path / "new" / "wheels.yaml"
    result = wheelsight("calibrate", "wheels", drive, "--out", out)
    assert result.exit_code == 0, result.output
    for word in ("580.00 mm", "track width", "± σ", "delay", "ATE, position", "RPE a metre, heading", "off at the end"):
        assert word in result.stdout
    found = wheels_in(out)
    assert found.track_width_m == pytest.approx(0.615, rel=3e-3)
    assert found.delay_s == pytest.approx(0.06, abs=5e-3)
    assert load_calibration(out).source == "wheels fitted on drive to its ground truth"
    page = out.with_suffix(".html").read_text(encoding="utf-8")
    assert "On the part it did not use" in page
    assert result.stdout.count(str(out.parent)) == 2
    assert sorted(path.name for path in out.parent.iterdir()) == ["wheels.html", "wheels.yaml"]


def test_a_run_takes_the_calibration(wheelsight: Command, drive: Path, tmp_path: Path) -> None:
    """The way to the end: calibrate once, run with it, and be nearer to the truth than without."""
    out = tmp_path / "wheels.yaml"
    assert wheelsight("calibrate", "wheels", drive, "--out", out).exit_code == 0
    errors = []
    for name, options in (("nominal", ()), ("calibrated", ("--calibration", out))):
        command = ("run", drive, "--odometry", "wheels", "--out", tmp_path / name, *options)
        assert wheelsight(*command).exit_code == 0
        metrics = json.loads((tmp_path / name / "metrics.json").read_text())
        errors.append(metrics["evaluation"]["rpe_per_metre_deg"]["median"])
    assert errors[1] < 0.5 * errors[0]


def test_a_reference_and_nominal_wheels_can_be_given(wheelsight: Command, drive: Path, tmp_path: Path) -> None:
    (drive / "groundtruth_base.txt").rename(tmp_path / "elsewhere.txt")
    nominal = tmp_path / "nominal.yaml"
    save_calibration(Calibration(wheels=replace(NOMINAL, track_width_m=0.7)), nominal)
    given = ("--reference", tmp_path / "elsewhere.txt", "--calibration", nominal)
    result = wheelsight("calibrate", "wheels", drive, *given, "--out", tmp_path / "wheels.yaml")
    assert result.exit_code == 0, result.output
    assert "700.00 mm" in result.stdout
    assert wheels_in(tmp_path / "wheels.yaml").track_width_m == pytest.approx(0.615, rel=3e-3)


def test_sigma_of_a_runs_own_trajectory_holds_what_the_camera_leaves_open(
    wheelsight: Command, drive: Path, tmp_path: Path
) -> None:
    """A trajectory with covariances.csv beside it is an estimate by the camera, whose calibration is nominal here."""
    reference, nominal = tmp_path / "trajectory.txt", tmp_path / "nominal.yaml"
    (drive / "groundtruth_base.txt").rename(reference)
    lens = PinholeCamera(640, 480, 525.0, 525.0, 319.5, 239.5)
    known = {"wheels": NOMINAL, "T_base_camera": MOUNT}
    save_calibration(Calibration.registered_camera(lens, **known), nominal)
    sigmas = []
    for name in ("truth", "visual"):
        given = ("--reference", reference, "--calibration", nominal, "--out", tmp_path / f"{name}.yaml")
        result = wheelsight("calibrate", "wheels", drive, *given)
        assert result.exit_code == 0, result.output
        sigmas.append(wheels_in(tmp_path / f"{name}.yaml").scale_sigma)
        (tmp_path / "covariances.csv").touch()
    assert sigmas[0] < 0.005
    assert 0.01 < sigmas[1] < 0.04


def test_a_delay_can_be_kept(wheelsight: Command, drive: Path, tmp_path: Path) -> None:
    result = wheelsight("calibrate", "wheels", drive, "--no-delay", "--out", tmp_path / "wheels.yaml")
    assert "kept" in result.stdout
    assert wheels_in(tmp_path / "wheels.yaml").delay_s == 0


def test_nothing_is_overwritten_unasked(wheelsight: Command, refusal: Refusal, drive: Path, tmp_path: Path) -> None:
    out = tmp_path / "wheels.yaml"
    out.write_text("mine")
    reported = refusal("calibrate", "wheels", drive, "--out", out)
    assert reported == f"{out}: is there already (choose another --out, or add --force to overwrite)"
    assert out.read_text() == "mine"
    assert wheelsight("calibrate", "wheels", drive, "--out", out, "--force").exit_code == 0
    out.unlink()
    assert "wheels.html: is there already" in refusal("calibrate", "wheels", drive, "--out", out)


def test_outputs_that_cannot_be_are_refused(refusal: Refusal, drive: Path, tmp_path: Path) -> None:
    assert "is a folder, not a file" in refusal("calibrate", "wheels", drive, "--out", tmp_path)
    assert "is the name of the page" in refusal("calibrate", "wheels", drive, "--out", tmp_path / "wheels.html")


def test_a_straight_drive_is_refused_and_leaves_nothing(refusal: Refusal, tmp_path: Path) -> None:
    legs = [(20.0, 0.8, 0.0), (2.0, 0.0, 0.0)] * 6
    write_recording(tmp_path / "straight", NOMINAL, simulate(TRUE, legs))
    reported = refusal("calibrate", "wheels", tmp_path / "straight", "--out", tmp_path / "wheels.yaml")
    assert reported.startswith("the drive does not determine: ")
    assert "track width" in reported
    assert "drive some full turns, both ways" in reported
    assert not (tmp_path / "wheels.yaml").exists()


@pytest.mark.parametrize(
    ("change", "reported"),
    [
        (lambda drive: (drive / "groundtruth_base.txt").unlink(), "drive has no ground truth to calibrate against"),
        (lambda drive: (drive / "wheels.csv").write_text("stamp_s,left,right\n1,2,3\n"), "drive has 1 wheel readings"),
        (lambda drive: (drive / "calibration.yaml").unlink(), "calibration.yaml: is missing"),
    ],
    ids=["no-truth", "no-readings", "no-wheels"],
)
def test_what_lacks_something_says_so(
    refusal: Refusal, drive: Path, tmp_path: Path, change: Callable[[Path], object], reported: str
) -> None:
    change(drive)
    assert reported in refusal("calibrate", "wheels", drive, "--out", tmp_path / "wheels.yaml")


def test_squares_are_distinguished_by_their_turning(wheelsight: Command, squares: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "wheels.yaml"
    result = wheelsight("calibrate", "umbmark", *squares, "--out", out)
    assert result.exit_code == 0, result.output
    for word in ("E_d, right over left", "E_b, track factor", "E_max,syst", "by wheels corrected without it"):
        assert word in result.stdout
    found = wheels_in(out)
    assert found.right_radius_m / found.left_radius_m == pytest.approx(1.006, abs=1e-3)
    assert found.track_width_m == pytest.approx(1.02 * 0.58, rel=5e-3)
    assert "Return position errors" in out.with_suffix(".html").read_text(encoding="utf-8")


def test_a_table_of_errors_will_do(wheelsight: Command, refusal: Refusal, tmp_path: Path) -> None:
    table, nominal, out = (tmp_path / name for name in ("errors.csv", "nominal.yaml", "wheels.yaml"))
    save_calibration(Calibration(wheels=NOMINAL), nominal)
    table.write_text("direction,x_m,y_m\ncw,-0.10,-0.10\ncw,-0.11,-0.09\nccw,-0.10,0.10\nccw,-0.09,0.11\n")
    assert "add --calibration and --side" in refusal("calibrate", "umbmark", table, "--out", out)
    result = wheelsight("calibrate", "umbmark", table, "--side", 4, "--calibration", nominal, "--out", out)
    assert result.exit_code == 0, result.output
    found = wheels_in(out)
    assert found.track_width_m > NOMINAL.track_width_m
    assert found.left_radius_m == pytest.approx(found.right_radius_m, rel=1e-3)


def test_squares_of_two_robots_are_refused(refusal: Refusal, squares: list[Path], tmp_path: Path) -> None:
    other = replace(NOMINAL, track_width_m=0.9)
    save_calibration(Calibration(wheels=other), squares[2] / "calibration.yaml")
    reported = refusal("calibrate", "umbmark", *squares, "--out", tmp_path / "wheels.yaml")
    assert reported.startswith("square2 and square0 have different nominal wheels")


@pytest.mark.parametrize("command", ["wheels", "umbmark"])
def test_help_shows_an_example(wheelsight: Command, command: str) -> None:
    result = wheelsight("calibrate", command, "--help")
    assert f"wheelsight calibrate {command} " in result.output.split("Examples")[1]


@pytest.mark.slow
@pytest.mark.browser
def test_the_pages_draw_all_they_promise(
    wheelsight: Command, drive: Path, squares: list[Path], tmp_path: Path, chromium: str
) -> None:
    for command, given, plots in (("wheels", [drive], 3), ("umbmark", squares, 1)):
        out = tmp_path / f"{command}.yaml"
        assert wheelsight("calibrate", command, *given, "--out", out).exit_code == 0
        document, complaints = open_page(chromium, out.with_suffix(".html"))
        assert complaints == []
        assert document.count('class="main-svg"') >= plots
        assert document.count('class="plot js-plotly-plot"') == plots
        assert "NaN" not in document.split("<script")[0]


def test_the_reference_is_read_as_reported(wheelsight: Command, refusal: Refusal, drive: Path, tmp_path: Path) -> None:
    camera = tmp_path / "camera.txt"
    truth = read_tum(drive / "groundtruth_base.txt")
    write_tum(Trajectory(truth.stamps_s, truth.T_frame_body, body="camera"), camera)
    reported = refusal("calibrate", "wheels", drive, "--reference", camera, "--out", tmp_path / "wheels.yaml")
    assert "give T_base_camera" in reported


def test_each_command_keeps_what_the_others_found(wheelsight: Command, drive: Path, tmp_path: Path) -> None:
    """FILE with --force is the recording's own calibration: its cameras, mount and gyroscope are still there."""
    own = drive / "calibration.yaml"
    camera = PinholeCamera(64, 48, 50.0, 50.0, 32.0, 24.0)
    before = Calibration.registered_camera(
        camera, T_base_camera=MOUNT, wheels=NOMINAL, gyro=Gyro(bias_rad_s=0.1), source="data sheet"
    )
    save_calibration(before, own)
    result = wheelsight("calibrate", "wheels", drive, "--out", own, "--force")
    assert result.exit_code == 0, result.output
    assert "(kept in it: cameras, mount, gyro)" in result.stdout
    found = load_calibration(own)
    assert found.cameras == (camera, camera)
    np.testing.assert_array_equal(found.T_base_camera, MOUNT)
    assert found.gyro.bias_rad_s == 0.1
    assert found.wheels is not None
    assert found.wheels.track_width_m == pytest.approx(0.615, rel=3e-3)
    assert found.source == "data sheet, updated by: wheels fitted on drive to its ground truth"


def test_what_was_given_is_handed_on(wheelsight: Command, drive: Path, tmp_path: Path) -> None:
    given, out = tmp_path / "given.yaml", tmp_path / "out.yaml"
    fields = {"T_base_camera": MOUNT.tolist(), "wheels": {"max_speed_m_s": 3.0, "delay_s": 0.02}}
    given.write_text(yaml.safe_dump({"format": "wheelsight-calibration-1", **fields}))
    result = wheelsight("calibrate", "wheels", drive, "--no-delay", "--calibration", given, "--out", out)
    assert result.exit_code == 0, result.output
    np.testing.assert_array_equal(load_calibration(out).T_base_camera, MOUNT)
    assert (wheels_in(out).max_speed_m_s, wheels_in(out).delay_s) == (3.0, 0.02)


def test_a_calibration_that_cannot_be_read_is_not_lost(refusal: Refusal, drive: Path, tmp_path: Path) -> None:
    out = tmp_path / "wheels.yaml"
    out.write_text("format: wheelsight-calibration-1\ncolour: {}\n")
    reported = refusal("calibrate", "wheels", drive, "--out", out, "--force")
    assert reported.startswith(f"{out}: field calibration has an unknown entry 'colour'")
    assert "colour" in out.read_text()


def test_a_file_larger_than_any_calibration_is_neither_read_nor_lost(
    refusal: Refusal, drive: Path, tmp_path: Path
) -> None:
    out = tmp_path / "wheels.yaml"
    out.write_bytes(bytes(2 << 20))
    reported = refusal("calibrate", "wheels", drive, "--out", out, "--force")
    assert reported.startswith(f"{out}: holds 2 MB, more than a YAML file may: 1 MB")
    assert out.stat().st_size == 2 << 20
