from pathlib import Path

import numpy as np
import pytest

from wheelsight.core.errors import RecordingError
from wheelsight.io.recordings import OpenOptions, matches_of, open_recording, read_matches

LINES = "odom2 0.0 0.5 0.01 0.2 0.1 0.2 0.3\nodom2 0.1 0.4 0 0 0.1 0.2 0.3\nloop 0.1 0.0 0.9\n"
TRUTH = "point2 0.0 1 2 0 0 0 0\nangle 0.0 0.5 0\n"
POSES = "stamp_a_s,stamp_b_s,x_m,y_m,z_m,qx,qy,qz,qw,sigma_m,sigma_rad,score\n1,2,0.1,0.2,0,0,0,1,0,0.05,0.02,0.8\n"


def written(folder: Path, text: str) -> Path:
    path = folder / "loops.csv"
    path.write_text(text)
    return path


def test_places_alone(tmp_path: Path) -> None:
    (first, second), warnings = read_matches(written(tmp_path, "stamp_b_s;stamp_a_s\n2,5;1\n4;3\n"))
    assert (first.stamp_a_s, first.stamp_b_s, first.T_a_b, first.score) == (1, 2.5, None, None)
    assert (second.stamp_a_s, second.stamp_b_s) == (3, 4)
    assert warnings == []


def test_relative_poses_with_their_errors(tmp_path: Path) -> None:
    ((match,), _) = read_matches(written(tmp_path, POSES))
    assert match.T_a_b is not None
    assert match.covariance is not None
    expected = np.array([[-1.0, 0, 0, 0.1], [0, -1, 0, 0.2], [0, 0, 1, 0], [0, 0, 0, 1]])
    np.testing.assert_allclose(match.T_a_b, expected, atol=1e-12)
    np.testing.assert_allclose(np.diag(match.covariance), np.square([0.05, 0.05, 0.05, 0.02, 0.02, 0.02]))
    assert match.score == 0.8


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("stamp_a_s,score\n1,1\n", r"loops\.csv:1: has no column stamp_b_s"),
        ("stamp_a_s,stamp_b_s\n1,x\n", r"loops\.csv:2: 'x' is not a stamp"),
        ("stamp_a_s,stamp_b_s,score\n1,2,1.5\n", r"loops\.csv:2: score is 1\.5"),
        ("stamp_a_s,stamp_b_s,x_m\n1,2,3\n", r"loops\.csv:1: has no column y_m"),
        ("stamp_a_s,stamp_b_s,sigma_m,sigma_rad\n1,2,3,3\n", r"loops\.csv:1: has sigmas and no poses"),
        (POSES.replace("0,0,1,0,0.05", "0,0,2,0,0.05"), r"loops\.csv:2: quaternion has length 2"),
        (POSES.replace("0.05,", "0,"), r"loops\.csv:2: a sigma is not positive"),
    ],
)
def test_bad_files_are_named_with_line_and_problem(tmp_path: Path, text: str, problem: str) -> None:
    with pytest.raises(RecordingError, match=problem):
        read_matches(written(tmp_path, text))


def test_a_recording_has_its_own_and_those_of_the_file_beside(tmp_path: Path) -> None:
    (tmp_path / "A_Input.txt").write_text(LINES)
    (tmp_path / "A_GT.txt").write_text(TRUTH)
    recording = open_recording(tmp_path, OpenOptions())
    ((own,), _) = matches_of(recording)
    assert (own.stamp_a_s, own.stamp_b_s, own.score) == (0.0, 0.1, 0.9)
    written(tmp_path, "stamp_a_s,stamp_b_s\n0,0.1\n")
    assert len(matches_of(recording)[0]) == 2


def test_stated_variances_are_those_of_the_lines(tmp_path: Path) -> None:
    (tmp_path / "A_Input.txt").write_text(LINES)
    (tmp_path / "A_GT.txt").write_text(TRUTH)
    stated = open_recording(tmp_path, OpenOptions()).speed_variances  # type: ignore[attr-defined]
    np.testing.assert_allclose(stated.variances, [[0.1, 0.2, 0.3]] * 2)
    (tmp_path / "A_Input.txt").write_text(LINES.replace("0.3\nloop", "-0.3\nloop"))
    with pytest.raises(RecordingError, match=r"A_Input\.txt:2: a variance is negative"):
        open_recording(tmp_path, OpenOptions())


def test_more_matches_than_any_drive_has_are_refused_before_they_are_read(tmp_path: Path) -> None:
    path = written(tmp_path, "stamp_a_s,stamp_b_s\n" + "1,2\n" * 100_001)
    with pytest.raises(RecordingError, match="more lines than a list of matches may have"):
        read_matches(path)
