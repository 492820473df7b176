from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from narrowing import of_type
from pipeline.made import OF_JOINED, metrics_in, names_in, status_in
from room_drive import make_room_drive

from wheelsight.app.run import RunRecord, best_alone_of, facts_of
from wheelsight.app.runs import run_each
from wheelsight.config import load_config
from wheelsight.core.trajectory import read_tum
from wheelsight.io.recordings import open_recording
from wheelsight.io.recordings.image_recording import ImageRecording
from wheelsight_report import summarise


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, tuple[RunRecord, ...]]:
    """A drive through a room by wheels and features (no stand-in), joined by the default filter."""
    folder = tmp_path_factory.mktemp("joined")
    make_room_drive(folder / "room", frames=4)
    config = load_config(overrides={"odometry": "wheels,features"})
    return folder / "out", run_each(open_recording(folder / "room"), config, folder / "out")


def test_a_joined_run_leaves_its_own_folder_and_figures(ran: tuple[Path, tuple[RunRecord, ...]]) -> None:
    out, records = ran
    assert [record.odometry for record in records] == ["wheels", "features", "joined"]
    assert names_in(out / "joined") == OF_JOINED
    joint, alone = metrics_in(out), metrics_in(out / "joined")
    found, facts = alone["joined"], facts_of(records[2])
    assert joint["odometry"]["joined"]["joined"] == found
    assert "joined" not in joint["odometry"]["wheels"]
    assert sum(found["seconds_by_status"].values()) == pytest.approx(sum(facts.seconds.values()))
    assert set(found["flag_shares"]) == {"slip", "doubtful", "degenerate"}
    assert found["consistency"]["drift_at_end_m"] == facts.consistency.drift_m  # type: ignore[union-attr]
    assert 0 <= found["consistency"]["within_three_sigma_share"] <= 1
    best_alone = best_alone_of(records)
    assert best_alone is not None
    assert joint["joined_beside_alone"] == {"better": best_alone.odometry, "ate_ratio": best_alone.ratio}


def test_its_trajectory_has_poses_at_frames_and_at_readings(ran: tuple[Path, tuple[RunRecord, ...]]) -> None:
    out, records = ran
    found = metrics_in(out / "joined")["joined"]
    poses = len(read_tum(out / "joined" / "trajectory.txt"))
    assert found["poses_at_frames"] + found["poses_at_wheel_readings_alone"] == poses
    assert found["poses_at_frames"] == metrics_in(out / "joined")["frames"]["with_pose"] == len(records[2].frames)
    readings = metrics_in(out / "wheels")["wheel_readings"]["with_pose"]
    assert readings - 1 <= found["poses_at_wheel_readings_alone"] <= readings  # the first may tell no pose yet


@pytest.mark.usefixtures("real_odometry")
@pytest.mark.parametrize("delay_s", [-0.008, -0.2])
def test_frames_that_readings_overtook_have_poses_too(tmp_path: Path, delay_s: float) -> None:
    """Calibrated wheels may lead: their readings' stamps are then later than those of frames reported after."""
    make_room_drive(tmp_path / "room", frames=4)
    recording = of_type(ImageRecording, open_recording(tmp_path / "room"))
    assert recording.calibration.wheels is not None
    early = replace(recording.calibration.wheels, delay_s=delay_s)
    recording = replace(recording, calibration=replace(recording.calibration, wheels=early))
    joined = run_each(recording, load_config(overrides={"odometry": "wheels,features"}), tmp_path / "out")[2]
    assert all(frame.pose_s > frame.stamp_s for frame in joined.frames)
    assert joined.evaluation is not None
    found = metrics_in(tmp_path / "out" / "joined")["frames"]
    assert joined.evaluation.frames_with_pose == summarise(joined).pose_share == found["with_pose_share"] == 1
    assert facts_of(joined).poses_at_frames == len({frame.pose_s for frame in joined.frames})


def test_frames_tell_their_flags(ran: tuple[Path, tuple[RunRecord, ...]]) -> None:
    out, records = ran
    rows = status_in(out / "joined")
    assert [row["flags"] for row in rows] == [";".join(frame.flags) for frame in records[2].frames]
    assert {row["flags"] for row in status_in(out / "wheels")} == {""}
