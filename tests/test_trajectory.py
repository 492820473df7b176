"""Trajectory: immutable values, interpolation, moving with covariance, and its text formats in the wild."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wheelsight.core.errors import OutputError, TrajectoryError
from wheelsight.core.geometry import se3, so3
from wheelsight.core.trajectory import Trajectory, read_kitti, read_tum, write_kitti, write_tum

POSE = "0 0 0 0 0 0 1"
EYE = "1 0 0 0 0 1 0 0 0 0 1 0"


def random_trajectory(n: int = 20, seed: int = 0, extent_m: float = 5.0, **others: Any) -> Trajectory:
    rng = np.random.default_rng(seed)
    xi = np.hstack([extent_m * rng.standard_normal((n, 3)), rng.standard_normal((n, 3))])
    stamps_s = 1.3e9 + np.cumsum(rng.uniform(0.01, 0.1, n))
    return Trajectory(stamps_s, se3.exp(xi), **others)


def tum_file(folder: Path, *lines: str, ending: str = "\n") -> Path:
    path = folder / "poses.txt"
    path.write_bytes(ending.join(lines).encode())
    return path


class TestValues:
    def test_nothing_in_it_can_be_changed(self) -> None:
        stamps_s = np.arange(3.0)
        trajectory = Trajectory(stamps_s, np.tile(np.eye(4), (3, 1, 1)), np.tile(np.eye(6), (3, 1, 1)))
        stamps_s[0] = -5
        assert trajectory.stamps_s[0] == 0
        for array in (trajectory.stamps_s, trajectory.T_frame_body, trajectory.covariances, trajectory.positions_m):
            assert array is not None
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 1
        with pytest.raises(AttributeError):
            trajectory.body = "base"  # type: ignore[misc]

    @pytest.mark.parametrize(
        ("stamps_s", "T", "says"),
        [
            ([0.0, 0.0], np.tile(np.eye(4), (2, 1, 1)), "strictly growing"),
            ([1.0, 0.0], np.tile(np.eye(4), (2, 1, 1)), "strictly growing"),
            ([0.0, np.nan], np.tile(np.eye(4), (2, 1, 1)), "finite"),
            ([0.0], np.tile(np.eye(4), (2, 1, 1)), r"\(N, 4, 4\)"),
            (0.0, np.eye(4), r"\(N,\)"),
            ([0.0], np.full((1, 4, 4), np.nan), "rigid"),
            ([0.0], np.diag([1.0, 1, -1, 1])[None], "rigid"),
            ([0.0], 2 * np.eye(4)[None], "rigid"),
        ],
    )
    def test_refuses_what_is_no_trajectory(self, stamps_s: Any, T: np.ndarray, says: str) -> None:
        with pytest.raises(TrajectoryError, match=says):
            Trajectory(stamps_s, T)

    def test_refuses_covariances_of_another_shape(self) -> None:
        with pytest.raises(TrajectoryError, match=r"\(1, 6, 6\)"):
            Trajectory(np.zeros(1), np.eye(4)[None], np.eye(3)[None])

    def test_may_be_empty(self) -> None:
        empty = Trajectory(np.empty(0), np.empty((0, 4, 4)))
        assert (len(empty), empty.duration_s, empty.length_m, empty.distances_m.shape) == (0, 0.0, 0.0, (0,))
        assert np.isnan(empty.at([1.0])).all()
        assert len(empty.between(0, 1)) == 0

    def test_length_is_the_sum_of_straight_steps(self) -> None:
        T = se3.from_parts(np.eye(3), [[0, 0, 0], [3, 4, 0], [3, 4, 2]])
        trajectory = Trajectory(np.array([10.0, 11.0, 13.0]), T)
        np.testing.assert_allclose(trajectory.distances_m, [0, 5, 7])
        assert (trajectory.length_m, trajectory.duration_s) == (7.0, 3.0)

    def test_iterates_over_stamps_and_poses(self) -> None:
        trajectory = random_trajectory(4)
        for k, (stamp_s, T) in enumerate(trajectory):
            assert stamp_s == trajectory.stamps_s[k]
            np.testing.assert_array_equal(T, trajectory.T_frame_body[k])


class TestParts:
    def test_select_takes_mask_indices_or_slice_with_covariances(self) -> None:
        covariances = np.arange(20.0)[:, None, None] * np.eye(6)
        trajectory = random_trajectory(covariances=covariances, body="base", frame="odom")
        mask = np.zeros(20, bool)
        mask[3:9:2] = True
        for which in (mask, [3, 5, 7], slice(3, 9, 2)):
            part = trajectory.select(which)
            np.testing.assert_array_equal(part.stamps_s, trajectory.stamps_s[3:9:2])
            np.testing.assert_array_equal(part.T_frame_body, trajectory.T_frame_body[3:9:2])
            np.testing.assert_array_equal(part.covariances, covariances[3:9:2])
            assert (part.body, part.frame) == ("base", "odom")
        assert len(trajectory.select([])) == 0
        with pytest.raises(TrajectoryError, match="growing"):
            trajectory.select([2, 1])

    def test_between_includes_both_ends(self) -> None:
        trajectory = Trajectory(np.arange(5.0), np.tile(np.eye(4), (5, 1, 1)))
        assert trajectory.between(1.0, 3.0).stamps_s.tolist() == [1.0, 2.0, 3.0]

    def test_at_follows_a_constant_twist_exactly(self) -> None:
        xi = np.array([0.4, -0.1, 0.2, 0.1, 0.5, -0.3])
        trajectory = Trajectory(np.arange(6.0), se3.exp(np.arange(6.0)[:, None] * xi))
        wanted = np.array([0.0, 0.25, 3.7, 5.0])
        np.testing.assert_allclose(trajectory.at(wanted), se3.exp(wanted[:, None] * xi), atol=1e-12)

    def test_at_says_nan_outside_and_in_gaps(self) -> None:
        trajectory = Trajectory(np.array([0.0, 1.0, 3.0]), np.tile(np.eye(4), (3, 1, 1)))
        known = ~np.isnan(trajectory.at([-0.1, 0.0, 0.5, 1.0, 2.0, 3.0, 3.1], max_gap_s=1.5)[:, 0, 0])
        assert known.tolist() == [False, True, True, True, False, True, False]


class TestMoved:
    def test_multiplies_from_the_left_and_keeps_names(self) -> None:
        trajectory, T_new_frame = random_trajectory(body="base"), se3.exp([1, 2, 3, 0.1, 0.2, 0.3])
        moved = trajectory.moved(T_new_frame)
        np.testing.assert_allclose(moved.T_frame_body, T_new_frame @ trajectory.T_frame_body)
        assert (moved.body, moved.covariances) == ("base", None)

    def test_covariance_is_that_of_moved_samples(self, rng: np.random.Generator) -> None:
        root = 0.01 * rng.standard_normal((6, 6))
        T_mean, T_new_frame = se3.exp(rng.standard_normal(6)), se3.exp([1.5, -0.7, 0.4, 0.3, -0.8, 0.5])
        samples = se3.exp(rng.standard_normal((100_000, 6)) @ root.T) @ T_mean
        moved = Trajectory(np.array([0.0]), T_mean[None], (root @ root.T)[None]).moved(T_new_frame)
        deltas = se3.log(T_new_frame @ samples @ se3.invert(moved.T_frame_body[0]))
        assert moved.covariances is not None
        sampled, expected = np.cov(deltas.T), moved.covariances[0]
        spread = np.sqrt(np.diag(expected))
        np.testing.assert_allclose(sampled / np.outer(spread, spread), expected / np.outer(spread, spread), atol=0.02)


class TestTum:
    @given(seed=st.integers(0, 2**16), n=st.integers(1, 30), body=st.sampled_from(["camera", "base"]))
    def test_reads_what_it_wrote(self, tmp_path_factory: pytest.TempPathFactory, seed: int, n: int, body: str) -> None:
        path = tmp_path_factory.mktemp("tum") / "trajectory.txt"
        trajectory = random_trajectory(n, seed, body=body, frame="odom")
        write_tum(trajectory, path)
        again = read_tum(path)
        np.testing.assert_array_equal(again.stamps_s, trajectory.stamps_s)
        np.testing.assert_allclose(again.T_frame_body, trajectory.T_frame_body, atol=5e-9)
        assert (again.body, again.frame) == (body, "odom")

    def test_stamps_closer_than_a_microsecond_stay_apart(self, tmp_path: Path) -> None:
        trajectory = Trajectory(np.array([0.0, 1e-7, 1.0]), np.tile(np.eye(4), (3, 1, 1)))
        write_tum(trajectory, tmp_path / "fast.txt")
        np.testing.assert_array_equal(read_tum(tmp_path / "fast.txt").stamps_s, trajectory.stamps_s)

    def test_header_says_the_frames(self, tmp_path: Path) -> None:
        write_tum(random_trajectory(1, body="base"), tmp_path / "t.txt")
        assert (tmp_path / "t.txt").read_text().startswith("# frames: T_map_base ")

    @pytest.mark.parametrize("ending", ["\n", "\r\n", "\r"])
    @pytest.mark.parametrize("mark", ["", "\ufeff"])
    def test_reads_comments_blanks_commas_and_any_line_ending(self, tmp_path: Path, ending: str, mark: str) -> None:
        lines = [
            f"{mark}# timestamp tx ty tz qx qy qz qw",
            "",
            f"1.5 {POSE} # here",
            "  2.5,\t1, 2, 3, 0,0,0, 1",
            "#end",
        ]
        trajectory = read_tum(tum_file(tmp_path, *lines, ending=ending), body="base")
        assert trajectory.stamps_s.tolist() == [1.5, 2.5]
        assert trajectory.positions_m[1].tolist() == [1, 2, 3]
        assert trajectory.body == "base"

    def test_brings_slightly_long_quaternions_to_unit_length(self, tmp_path: Path) -> None:
        path = tum_file(tmp_path, "0 0 0 0 0.5030 0.5030 0.5030 0.5030")
        np.testing.assert_allclose(so3.angle(read_tum(path).T_frame_body[0, :3, :3]), 2 * np.pi / 3, atol=1e-12)

    @pytest.mark.parametrize(
        ("lines", "where", "says"),
        [
            ([f"1 {POSE}", f"1 {POSE}"], 2, "repeats"),
            ([f"2 {POSE}", "# back", f"1 {POSE}"], 3, "comes before"),
            ([f"1 {POSE}", "2 0 0 nan 0 0 0 1"], 2, "not finite"),
            ([f"1 {POSE}", "inf 0 0 0 0 0 0 1"], 2, "not finite"),
            (["1 0 0 0 0 0 0 0"], 1, "quaternion has length 0"),
            (["1 0 0 0 0 0 0.5 1"], 1, "quaternion has length 1.118"),
            (["1 0 0 0 0 0 1"], 1, "7 values where 8"),
            ([f"1 {POSE} 9"], 1, "9 values where 8"),
            (["1 0 0 zero 0 0 0 1"], 1, "zero"),
        ],
    )
    def test_an_error_names_file_and_line(self, tmp_path: Path, lines: list[str], where: int, says: str) -> None:
        path = tum_file(tmp_path, *lines)
        with pytest.raises(TrajectoryError, match=says) as caught:
            read_tum(path)
        assert (caught.value.path, caught.value.line) == (path, where)
        assert str(caught.value).startswith(f"{path}:{where}: ")
        assert "\n" not in str(caught.value)

    @pytest.mark.parametrize("lines", [[], ["# only a comment", ""]])
    def test_a_file_without_poses_is_refused(self, tmp_path: Path, lines: list[str]) -> None:
        path = tum_file(tmp_path, *lines)
        with pytest.raises(TrajectoryError, match="holds no poses"):
            read_tum(path)

    def test_absent_and_binary_files_are_refused(self, tmp_path: Path) -> None:
        with pytest.raises(TrajectoryError, match=r"absent.txt: cannot be read: No such file"):
            read_tum(tmp_path / "absent.txt")
        (tmp_path / "image.png").write_bytes(b"\x89PNG\xff\xfe")
        with pytest.raises(TrajectoryError, match=r"image.png: is not a text file"):
            read_tum(tmp_path / "image.png")

    def test_keeps_the_first_of_a_rare_repeated_stamp_and_says_so(self, tmp_path: Path) -> None:
        lines = [f"{k} {k} 0 0 0 0 0 1" for k in range(200)]
        lines.insert(50, "49 7 7 7 0 0 0 1")
        notes: list[str] = []
        trajectory = read_tum(tum_file(tmp_path, *lines), warn=notes.append)
        np.testing.assert_array_equal(trajectory.positions_m[:, 0], np.arange(200))
        assert len(notes) == 1
        assert "1 of 201 lines repeat a stamp (first: line 51)" in notes[0]

    def test_stamps_cut_to_seconds_are_refused_not_thinned(self, tmp_path: Path) -> None:
        path = tum_file(tmp_path, *[f"{k // 30} {POSE}" for k in range(300)])
        with pytest.raises(TrajectoryError, match=r":2: .*290 of 300 lines.*all their decimals"):
            read_tum(path)

    def test_cannot_be_written_into_a_missing_folder(self, tmp_path: Path) -> None:
        with pytest.raises(OutputError, match="does not exist"):
            write_tum(random_trajectory(2), tmp_path / "nowhere" / "t.txt")


class TestKitti:
    @given(seed=st.integers(0, 2**16), n=st.integers(1, 30))
    def test_reads_what_it_wrote(self, tmp_path_factory: pytest.TempPathFactory, seed: int, n: int) -> None:
        path = tmp_path_factory.mktemp("kitti") / "poses.txt"
        trajectory = random_trajectory(n, seed)
        write_kitti(trajectory, path)
        again = read_kitti(path, period_s=0.5, body="base")
        np.testing.assert_allclose(again.T_frame_body, trajectory.T_frame_body, atol=5e-8)
        np.testing.assert_array_equal(again.stamps_s, 0.5 * np.arange(n))
        assert again.body == "base"

    def test_brings_rounded_rotations_to_the_nearest_one(self, tmp_path: Path) -> None:
        R = so3.exp([0.3, -0.2, 0.5])
        rows = np.hstack([R.round(4), [[1.0], [2.0], [3.0]]])
        path = tum_file(tmp_path, " ".join(map(str, rows.ravel())))
        np.testing.assert_allclose(read_kitti(path).T_frame_body[0, :3, :3], R, atol=1e-4)

    @pytest.mark.parametrize(
        ("lines", "where", "says"),
        [
            ([EYE, "1 0 0 0 0 1 0 0 0 0 -1 0"], 2, "no rotation"),
            ([EYE, EYE.replace("1", "2")], 2, "no rotation"),
            ([EYE, f"0 {POSE}"], 2, "8 values where 12"),
            (["1 0 0 nan 0 1 0 0 0 0 1 0"], 1, "not finite"),
        ],
    )
    def test_an_error_names_file_and_line(self, tmp_path: Path, lines: list[str], where: int, says: str) -> None:
        path = tum_file(tmp_path, *lines)
        with pytest.raises(TrajectoryError, match=says) as caught:
            read_kitti(path)
        assert (caught.value.path, caught.value.line) == (path, where)


@pytest.mark.data
def test_every_real_trajectory_reads(data_folder: Path) -> None:
    paths = sorted((data_folder / "trajectories").rglob("*.txt"))
    assert len(paths) >= 9
    notes: dict[str, str] = {}
    for path in paths:
        if path.name.startswith("KITTI"):
            assert len(read_kitti(path)) == 4541
        else:
            assert len(read_tum(path, warn=lambda note, name=path.name: notes.update({name: note}))) > 700  # type: ignore[misc]
    assert sorted(notes) == ["fr2_desk_groundtruth.txt", "freiburg2_pioneer_slam.txt"]
    assert "10 of 44212 lines repeat a stamp (first: line 1376)" in notes["freiburg2_pioneer_slam.txt"]


DIALECT = "1.5 0.25 2 3 0 0 0 1\n2.5 0.5 2 3 0 0 0 1\n"


@pytest.mark.parametrize(
    "text",
    [
        "timestamp tx ty tz qx qy qz qw\n" + DIALECT,
        '"Time","X","Y","Z","QX","QY","QZ","QW"\n' + DIALECT.replace(" ", ","),
        "stamp_s,tx,ty,tz,qw,qx,qy,qz,note\n" + DIALECT.replace("0 0 0 1", "1 0 0 0 a").replace(" ", ","),
        DIALECT.replace(" ", ";").replace(".", ","),
        DIALECT.replace(".", ","),
        DIALECT.replace(" ", ", ").replace("\n", ",\r\n"),
        "\ufeff# a comment\n" + DIALECT.replace(" ", "\t") + "\n\n",
        DIALECT.encode("utf-16"),
    ],
)
def test_tum_text_of_all_dialects_is_read(tmp_path: Path, text: str | bytes) -> None:
    path = tmp_path / "a.txt"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    trajectory = read_tum(path)
    np.testing.assert_array_equal(trajectory.stamps_s, [1.5, 2.5])
    np.testing.assert_array_equal(trajectory.positions_m, [[0.25, 2, 3], [0.5, 2, 3]])
    np.testing.assert_allclose(trajectory.T_frame_body[:, :3, :3], [np.eye(3)] * 2)


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        (DIALECT.replace(" ", ",").replace(".", ","), ":1: 10 values where 8 are expected"),
        ("time x y z\n" + DIALECT, ":1: names no column qx (name the columns stamp tx ty tz qx qy qz qw)"),
        ("t x tx y z qx qy qz qw\n" + DIALECT, ":1: names more than one column tx"),
        ("t x y z qx qy qz qw a\n" + DIALECT, ":2: 8 values where the first line names 9"),
        ("a b\n" + DIALECT, ":1: names no column timestamp"),
        (DIALECT.replace("0.5", "1e100"), ":2: a value of 1e+100 is no stamp in seconds and no metres"),
        (DIALECT.replace("2.5", "1e30"), ":2: a value of 1e+30 is no stamp"),
        (DIALECT.replace("0.5", "-inf"), ":2: a value is not finite (remove the line)"),
        (DIALECT.replace("0.5", "0\0.5"), ":2: holds a NUL character"),
    ],
)
def test_the_rest_is_refused_with_the_fix(tmp_path: Path, text: str, reported: str) -> None:
    (tmp_path / "a.txt").write_text(text)
    with pytest.raises(TrajectoryError) as caught:
        read_tum(tmp_path / "a.txt")
    assert str(caught.value).startswith(f"{tmp_path / 'a.txt'}{reported}")


@pytest.mark.parametrize(
    "head",
    [
        *("# timestamp_ms tx ty tz qx qy qz qw\n", "# frames: T_world_base\n# time [ms] tx ty\n"),
        *("stamp_ms,tx,ty,tz,qx,qy,qz,qw\n", "time [ms] tx ty tz qx qy qz qw\n", "# time in ms\n# by hand\n\n"),
    ],
)
def test_a_unit_that_the_first_line_names_is_read(tmp_path: Path, head: str) -> None:
    path = tmp_path / "t.txt"
    path.write_text(head + "1500 1 2 3 0 0 0 1\n2500 4 5 6 0 0 0 1\n")
    np.testing.assert_array_equal(read_tum(path).stamps_s, [1.5, 2.5])


def test_many_poses_are_read_at_once_as_line_by_line(tmp_path: Path, rng: np.random.Generator) -> None:
    """A comment further down has it read line by line; both ways tell the same."""
    plain, odd = tmp_path / "plain.txt", tmp_path / "odd.txt"
    rows = [f"{i / 100} {x!r} {y!r} 0 0 0 0 1\n" for i, (x, y) in enumerate(rng.normal(size=(2000, 2)).tolist())]
    plain.write_text("# frames: T_odom_base\n" + "".join(rows))
    odd.write_text("# frames: T_odom_base\n" + "".join(rows) + "# the end\n")
    a, b = read_tum(plain), read_tum(odd)
    np.testing.assert_array_equal(a.stamps_s, b.stamps_s)
    np.testing.assert_array_equal(a.T_frame_body, b.T_frame_body)
    assert (a.frame, a.body) == (b.frame, b.body) == ("odom", "base")


def test_what_may_be_written_to_is_copied_and_what_may_not_is_not() -> None:
    stamps_s, T = np.arange(3.0), np.tile(np.eye(4), (3, 1, 1)).copy()
    copied = Trajectory(stamps_s, T)
    T[1, 0, 3] = 5.0
    assert copied.T_frame_body[1, 0, 3] == 0
    T.setflags(write=False)
    assert Trajectory(stamps_s, T).T_frame_body is T
    above = np.tile(np.eye(4), (3, 1, 1))[:]
    view = above[:]
    view.setflags(write=False)
    seen_through = Trajectory(stamps_s, view)
    above[2, 1, 3] = 7.0
    assert seen_through.T_frame_body[2, 1, 3] == 0
