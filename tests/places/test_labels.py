"""Labels from files and from polygons; each thing that a person may have got wrong is reported with its line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from places.made_recording import rooms, straight

from wheelsight.core.errors import AreaError
from wheelsight_papers import labels_on_the_way, read_labels
from wheelsight_papers.dataset import natural_order

NAMES = ("corridor", "hall", "lift")
STAMPS_S = np.arange(0, 10, 0.5)


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "labels.csv"
    path.write_text(text, encoding="utf-8")
    return path


def of_frames(tmp_path: Path, text: str, names: tuple[str, ...] = NAMES) -> list[int]:
    return read_labels(written(tmp_path, text)).of_frames(STAMPS_S, names).tolist()


def test_ranges_name_their_frames_and_no_others(tmp_path: Path) -> None:
    labels = of_frames(tmp_path, "from_s,to_s,area\n1,2.9,hall\n6,8,lift\n3,5,corridor\n")
    assert labels == [-1, -1, 1, 1, 1, 1, 0, 0, 0, 0, 0, -1, 2, 2, 2, 2, 2, -1, -1, -1]


def test_a_frame_where_two_ranges_meet_belongs_to_the_later(tmp_path: Path) -> None:
    labels = of_frames(tmp_path, "from_s,to_s,area\n0,5,hall\n5,9.5,lift\n")
    assert labels == [1] * 10 + [2] * 10


def test_ranges_may_reach_beyond_the_recording_and_say_none(tmp_path: Path) -> None:
    labels = of_frames(tmp_path, "from_s,to_s,area\n-5,4.6,hall\n4.6,7,\n7,99,lift\n")
    assert labels == [1] * 10 + [-1] * 4 + [2] * 6


def test_names_may_hold_commas_and_any_letters_and_the_file_comments(tmp_path: Path) -> None:
    path = written(tmp_path, '\ufefffrom_s,to_s,area,note\n# by hand\n\n0,2,"Küche, oben",dark\n2,3,10\n3,4,9\n')
    assert read_labels(path).names == ("9", "10", "Küche, oben")
    assert [entry.line for entry in read_labels(path).entries] == [4, 5, 6]


def test_frames_are_named_one_by_one(tmp_path: Path) -> None:
    labels = of_frames(tmp_path, "stamp_s,area,p(hall)\n0.0004,hall,0.9\n1.0,,0.3\n9.5,lift,0.1\n")
    assert labels == [1] + [-1] * 18 + [2]


def test_what_a_broken_off_recording_leaves_is_read(tmp_path: Path) -> None:
    assert of_frames(tmp_path, "stamp_s,area\n9.5,lift\n10.0,lift\n")[-1] == 2
    assert of_frames(tmp_path, "stamp_s,area\n9.0,lift\n9.5,li")[-2:] == [2, -1]


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("from_s,to_s,area\n0,2,hall\n2,3,hal\n", "3: there is no area 'hal' (did you mean hall?)"),
        ("from_s,to_s,area\n0,2,x\n", "2: there is no area 'x' (areas: corridor, hall, lift)"),
        (
            "from_s,to_s,area\n4,6,hall\n0,4.5,lift\n",
            "2: 4.000 to 6.000 s overlaps line 3, 0.000 to 4.500 s (begin a range where the one before it ends)",
        ),
        (
            "from_s,to_s,area\n20,30,hall\n",
            "2: 20.000 to 30.000 s lies outside the recording, 0.000 to 9.500 s (stamps are the recording's own, ",
        ),
        ("from_s,to_s,area\n-3,-1,hall\n", "2: -3.000 to -1.000 s lies outside the recording"),
        ("from_s,to_s,area\n3,3,hall\n", "2: the range 3 to 3 s is empty (from_s before to_s)"),
        ("from_s,to_s,area\n0,nan,hall\n", "2: to_s is 'nan', no stamp in seconds (from_s,to_s,area)"),
        ("from_s,to_s,area\n0,ten,hall\n", "2: to_s is 'ten', no stamp in seconds"),
        ("from_s,to_s,area\n0,1\n", "2: 2 values where 3 are expected (from_s,to_s,area)"),
        ("stamp_s,area\n30,hall\n31,hall\n", "2: 30.000 s lies outside the recording"),
        (
            "stamp_s,area\n0,hall\n0.2,hall\n",
            "3: no frame has the stamp 0.200000; the nearest has 0.000000 (label the frames of this recording, or ",
        ),
        ("stamp_s,area\n1,hall\n1,lift\n", "3: stamp 1.000000 is that of line 2 too (one line a frame)"),
        ("time,area\n", "1: the first line is 'time,area' (name the columns: from_s,to_s,area or stamp_s,area)"),
        ("", "1: the first line is '' (name the columns: "),
    ],
)
def test_what_is_wrong_is_reported_with_its_line(tmp_path: Path, text: str, problem: str) -> None:
    with pytest.raises(AreaError) as caught:
        of_frames(tmp_path, text)
    assert str(caught.value).startswith(f"{tmp_path / 'labels.csv'}:{problem}")


def test_a_file_that_cannot_be_read_is_reported(tmp_path: Path) -> None:
    with pytest.raises(AreaError, match=r"absent\.csv: cannot be read: No such file"):
        read_labels(tmp_path / "absent.csv")
    (tmp_path / "model").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(AreaError, match="model: is not a text file"):
        read_labels(tmp_path / "model")


@pytest.mark.parametrize(
    "text",
    [
        "From_s;To_s;Area\n0,5;2;hall\n2;3,5;lift, left\n",
        'from_s, to_s, area, note\n0.5, 2, hall, x\n2, 3.5, "lift, left"\n'.replace(', "', ',"'),
        '# a comment\n\nfrom_s,to_s,area\n0.5,2,hall\n\n2,3.5,"lift, left"\n  ',
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_labels_of_all_dialects_are_read(tmp_path: Path, text: str, encoding: str) -> None:
    (tmp_path / "labels.csv").write_bytes(text.encode(encoding))
    entries = read_labels(tmp_path / "labels.csv").entries
    assert [(entry.from_s, entry.to_s, entry.area) for entry in entries] == [(0.5, 2, "hall"), (2, 3.5, "lift, left")]


def test_a_stamp_beyond_all_sense_is_refused(tmp_path: Path) -> None:
    (tmp_path / "labels.csv").write_text("stamp_s,area\n1,a\n1e100,b\n")
    with pytest.raises(AreaError, match=r"labels\.csv:3: stamp_s is '1e100', no stamp in seconds"):
        read_labels(tmp_path / "labels.csv")


def test_names_with_endless_numbers_are_sorted_too() -> None:
    long = "9" * 5000
    assert natural_order({f"room {long}", "room 2", "room 10"}) == ("room 2", "room 10", f"room {long}")


def test_polygons_and_a_way_tell_where_poses_are_known() -> None:
    way = straight(np.array([0.0, 1.0, 2.0, 6.0]), np.array([-2.0, 1.0, 4.0, 8.0]))
    labels = labels_on_the_way(rooms(), way, [-1.0, 0.0, 0.9, 1.4, 2.0, 4.0, 6.0, 7.0], max_gap_s=1.5)
    assert labels.tolist() == [-1, -1, 0, 0, 1, -1, 2, -1]


def test_numbers_in_names_are_sorted_by_their_value() -> None:
    assert natural_order({"room 10", "room 2", "Hall", "9", "10"}) == ("9", "10", "Hall", "room 2", "room 10")


@given(st.lists(st.integers(-1, 2), min_size=2, max_size=30))
def test_ranges_cut_between_frames_give_every_frame_its_label(tmp_path_factory, wanted: list[int]) -> None:
    stamps_s = 1305031453.25 + 0.1 * np.arange(len(wanted))
    lines = ["from_s,to_s,area"]
    for index, area in enumerate(wanted):
        if area >= 0:
            lines.append(f"{stamps_s[index] - 0.05:.6f},{stamps_s[index] + 0.05:.6f},{NAMES[area]}")
    path = written(tmp_path_factory.mktemp("ranges"), "\n".join(lines))
    assert read_labels(path).of_frames(stamps_s, NAMES).tolist() == wanted
