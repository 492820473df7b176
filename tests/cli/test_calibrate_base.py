from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import open_page
from drives import simulate as drive_legs
from drives import write_recording
from html_page import Page
from sighted_drives import MOUNT, NOMINAL, USUAL, nominal, sighted
from typer.testing import Result

from wheelsight.config import load_config
from wheelsight.core.calibration import Calibration, load_calibration, read_layer, save_calibration
from wheelsight.core.settings.calibration import ExtrinsicsSettings
from wheelsight.io.recordings import OpenOptions, Recording, open_recording
from wheelsight_calibration import base
from wheelsight_calibration.base import BaseCalibration, base_from, mount_values
from wheelsight_sim import RobotModel, SimulationSettings, simulate, write_simulation

Command = Callable[..., Result]
Refusal = Callable[..., str]

BELIEVED = RobotModel().T_base_camera
LEGS = (
    *((1.0, 0.5, 0.0), (4.0, 0.5, 0.0), (4.0, 0.35, 0.8), (3.0, 0.5, 0.0), (2.0, 0.0, 0.8), (1.0, 0.0, 0.0)),
    *((4.0, 0.35, -0.8), (3.0, 0.6, 0.0), (3.0, 0.0, -0.9), (2.0, 0.4, 0.2), (4.0, 0.4, 0.7), (1.0, 0.0, 0.0)),
    *((3.0, 0.5, -0.3), (4.0, 0.3, -0.8), (3.0, 0.5, 0.0), (3.0, 0.0, 0.8), (3.0, 0.4, 0.0), (4.0, 0.3, -0.7)),
)


@pytest.fixture(scope="module")
def found() -> BaseCalibration:
    seen = sighted(replace(NOMINAL, delay_s=0.03), rng=np.random.default_rng(3), blur=USUAL)
    return replace(base_from(seen, nominal(BELIEVED)), recording="drive", warnings=("The <light> went out.",))


@pytest.fixture
def drive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, found: BaseCalibration) -> Path:
    """A recording whose images no one rendered; what they would have shown is known."""
    write_recording(tmp_path / "drive", NOMINAL, drive_legs(NOMINAL))

    def calibrate(
        recording: Recording, on_frame: Callable[[str], None], settings: ExtrinsicsSettings
    ) -> BaseCalibration:
        on_frame("tracking")
        warning = f"{settings.floor.highest_m:g} high"
        return replace(found, recording=recording.name, warnings=(*found.warnings, warning))

    monkeypatch.setattr(base, "calibrate_base", calibrate)
    return tmp_path / "drive"


def test_a_drive_gives_a_mount_and_a_page(wheelsight: Command, drive: Path, tmp_path: Path) -> None:
    out = tmp_path / "new" / "base.yaml"
    result = wheelsight("calibrate", "base", drive, "--out", out)
    assert result.exit_code == 0, result.output
    for word in ("roll, leans right", "height over the floor", "± σ", "350.0 mm", "30.", "floor seen in"):
        assert word in result.stdout
    assert "The <light> went out." in result.stderr
    written = load_calibration(out)
    assert written.source == "mount found on drive"
    assert set(read_layer(out)["wheels"]) == {"delay_s"}
    assert written.T_base_camera is not None
    np.testing.assert_allclose(written.T_base_camera, MOUNT, atol=0.01)
    assert written.wheels is not None
    assert written.wheels.delay_s == pytest.approx(0.03, abs=5e-3)
    assert sorted(path.name for path in out.parent.iterdir()) == ["base.html", "base.yaml"]


def test_the_page_shows_what_it_was_seen_by(wheelsight: Command, drive: Path, tmp_path: Path) -> None:
    out = tmp_path / "base.yaml"
    assert wheelsight("calibrate", "base", drive, "--out", out).exit_code == 0
    text = out.with_suffix(".html").read_text(encoding="utf-8")
    for word in ("The camera&#x27;s mount, to", "The mount", "What the drive shows", "The floor, view by view"):
        assert word in text
    assert "The &lt;light&gt; went out." in text
    page = Page(text)
    assert len(page.plots) == 4
    assert all(plot.alt for plot in page.plots.values())


@pytest.mark.slow
def test_the_page_draws(wheelsight: Command, chromium: str, drive: Path, tmp_path: Path) -> None:
    out = tmp_path / "base.yaml"
    assert wheelsight("calibrate", "base", drive, "--out", out).exit_code == 0
    text, complaints = open_page(chromium, out.with_suffix(".html"))
    assert not complaints
    assert all(any(plot.drawn) for plot in Page(text).plots.values())


def test_a_recording_takes_the_mount(wheelsight: Command, drive: Path, tmp_path: Path) -> None:
    """It wins over the recording's own, and leaves its wheels' sizes."""
    out = tmp_path / "base.yaml"
    assert wheelsight("calibrate", "base", drive, "--out", out).exit_code == 0
    own = Calibration(T_base_camera=BELIEVED, wheels=NOMINAL, source="data sheet")
    save_calibration(own, drive / "calibration.yaml")
    opened = open_recording(drive, OpenOptions(calibration=str(out))).calibration
    assert opened.T_base_camera is not None
    np.testing.assert_allclose(opened.T_base_camera, MOUNT, atol=0.01)
    assert opened.wheels is not None
    assert opened.wheels.track_width_m == NOMINAL.track_width_m


def test_nothing_is_overwritten_unasked(wheelsight: Command, refusal: Refusal, drive: Path, tmp_path: Path) -> None:
    out = tmp_path / "base.yaml"
    out.write_text("mine")
    reported = refusal("calibrate", "base", drive, "--out", out)
    assert reported == f"{out}: is there already (choose another --out, or add --force to overwrite)"
    assert wheelsight("calibrate", "base", drive, "--out", out, "--force").exit_code == 0
    assert load_calibration(out).T_base_camera is not None


def test_it_goes_by_settings(wheelsight: Command, refusal: Refusal, drive: Path, tmp_path: Path) -> None:
    out, config = tmp_path / "base.yaml", tmp_path / "settings.yaml"
    config.write_text("extrinsics:\n  floor: {highest_m: 0.35}\n")
    assert "0.35 high" in wheelsight("calibrate", "base", drive, "--config", config, "--out", out).stderr
    config.write_text("extrinsics:\n  floor: {highest_m: 200}\n")
    reported = refusal("calibrate", "base", drive, "--config", config, "--out", tmp_path / "other.yaml")
    assert reported.startswith(f"{config}:2: extrinsics.floor.highest_m is 200")


def test_a_recording_without_images_is_refused(refusal: Refusal, wheels: Path, tmp_path: Path) -> None:
    assert "has no cameras" in refusal("calibrate", "base", wheels, "--out", tmp_path / "base.yaml")
    assert not (tmp_path / "base.yaml").exists()


def test_a_recording_without_wheels_is_refused(refusal: Refusal, room: Path, tmp_path: Path) -> None:
    reported = refusal("calibrate", "base", room, "--out", tmp_path / "base.yaml")
    assert "has no wheels (give nominal ones" in reported


def test_calibrations_are_laid_over_each_other(wheelsight: Command, drive: Path, tmp_path: Path) -> None:
    """Wheels from one file, the mount and the delay from another, whichever command knew of the other's."""
    nominal = replace(NOMINAL, track_width_m=NOMINAL.track_width_m * 1.01)
    save_calibration(Calibration(T_base_camera=BELIEVED, wheels=nominal), drive / "calibration.yaml")
    sizes, base, both = (tmp_path / f"{name}.yaml" for name in ("sizes", "base", "both"))
    commands = (
        ("wheels", drive, "--out", sizes),
        ("base", drive, "--out", base),
        ("base", drive, "--calibration", sizes, "--out", both),
    )
    for command in commands:
        assert wheelsight("calibrate", *command).exit_code == 0
    for files in ((sizes, base), (both,), (base, both)):
        found = open_recording(drive, OpenOptions(calibration=files)).calibration
        assert found.T_base_camera is not None
        np.testing.assert_allclose(found.T_base_camera, MOUNT, atol=0.01)
        assert found.wheels is not None
        assert found.wheels.delay_s == pytest.approx(0.03, abs=5e-3)
        assert found.wheels.track_width_m == pytest.approx(NOMINAL.track_width_m, rel=2e-3)
        assert found.wheels.ticks_per_turn == NOMINAL.ticks_per_turn


@pytest.mark.slow
def test_a_simulated_drive_from_end_to_end(wheelsight: Command, tmp_path: Path) -> None:
    """Rendered, written, calibrated by the command, and run with what it found."""
    table = ["stamp_s,v_m_s,yaw_rate_rad_s"]
    begins = np.cumsum([0.0, *(leg[0] for leg in LEGS)])
    table += [f"{begin},{v},{w}" for begin, (_, v, w) in zip(begins, (*LEGS, (0.0, 0.0, 0.0)), strict=True)]
    (tmp_path / "legs.csv").write_text("\n".join(table) + "\n")
    robot = RobotModel(camera_yaw_rad=-0.2, camera_left_m=-0.15)
    how: dict[str, Any] = {"world": "square", "size": (320, 240), "rate_hz": 5, "seed": 5}
    settings = SimulationSettings(velocities=tmp_path / "legs.csv", robot=robot, **how)
    write_simulation(simulate(settings), tmp_path / "drive")
    out = tmp_path / "base.yaml"
    result = wheelsight("calibrate", "base", tmp_path / "drive", "--out", out)
    assert result.exit_code == 0, result.output
    T_base_camera = load_calibration(out).T_base_camera
    assert T_base_camera is not None
    truth = mount_values(robot.T_base_camera)
    for name, value in mount_values(T_base_camera).items():
        limit = np.radians(0.5) if name in ("roll", "pitch", "yaw") else 0.01
        assert value == pytest.approx(truth[name], abs=limit), name
    sizes = tmp_path / "sizes.yaml"
    assert wheelsight("calibrate", "wheels", tmp_path / "drive", "--out", sizes).exit_code == 0
    given = ("--calibration", sizes, "--calibration", out)
    result = wheelsight("run", tmp_path / "drive", "--odometry", "wheels,features", *given, "--out", tmp_path / "run")
    assert result.exit_code == 0, result.output
    metrics = json.loads((tmp_path / "run" / "joined" / "metrics.json").read_text())
    assert metrics["evaluation"]["ate_m"]["rmse"] < 0.03
    recording = load_config(tmp_path / "run" / "config.yaml").recording
    assert recording.calibration == (str(sizes), str(out))
