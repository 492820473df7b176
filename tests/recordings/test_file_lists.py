"""Lists of images as people's programs write them: what is unambiguous is read, and the rest refused with the fix."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from wheelsight.core.errors import RecordingError
from wheelsight.io.recordings import open_recording
from wheelsight.io.recordings.tables import read_file_list

SOUND = "1.5 rgb/1.png\n2.5 rgb/2.png\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "rgb").mkdir()
    for name in ("1.png", "2.png"):
        (tmp_path / "rgb" / name).touch()
    return tmp_path


def read(folder: Path, text: str | bytes) -> tuple[list[tuple[float, str]], list[str]]:
    (folder / "rgb.txt").write_bytes(text if isinstance(text, bytes) else text.encode())
    files, warnings = read_file_list(folder / "rgb.txt")
    return [(file.stamp_s, str(file.path.relative_to(folder))) for file in files], warnings


@pytest.mark.parametrize(
    "text",
    [
        "timestamp,filename\n" + SOUND.replace(" ", ","),
        "# a comment\nTimestamp Filename\n" + SOUND,
        '"time [s]";"file"\n' + SOUND.replace(" ", "; "),
        SOUND.replace(".5 ", ",5 "),
        SOUND.replace(".5 ", ",5;"),
        '1.5 "rgb/1.png"\n2.5 "rgb/2.png"\n',
        '"1.5","rgb/1.png"\n"2.5","rgb/2.png"\n',
        "1.5 rgb/1.png 640 480\n2.5 rgb/2.png 640 480\n",
        "1.5,rgb/1.png,0.1,\n2.5,rgb/2.png,0.2,\n",
        "1.5 rgb/1.png # the first\n2.5 rgb/2.png\n",
        SOUND.replace("/", "\\"),
        SOUND.replace(" ", "\t").replace("\n", "\r"),
        SOUND.encode("utf-16"),
        SOUND.encode("utf-8-sig"),
        SOUND + "\n\n   ",
    ],
)
def test_lists_of_all_dialects_are_read(folder: Path, text: str | bytes) -> None:
    assert read(folder, text) == ([(1.5, "rgb/1.png"), (2.5, "rgb/2.png")], [])


@pytest.mark.parametrize(
    ("head", "per_second"),
    [
        ("# timestamp_ns,filename\n", 1e9),
        ("timestamp [ns],filename\n", 1e9),
        ("time (µs) file\n", 1e6),
        ("# a comment\n# time in milliseconds, file\n", 1e3),
        ("stamp_ms file\n", 1e3),
        ("# timestamp filename\n", 1),
        ("# 2 rgb images, time in order\n", 1),
    ],
)
def test_a_unit_that_the_first_line_names_is_read(folder: Path, head: str, per_second: float) -> None:
    lines = [f"{stamp_s * per_second:.1f} rgb/{n}.png\n" for n, stamp_s in ((1, 1.5), (2, 2.5))]
    assert read(folder, head + "".join(lines)) == ([(1.5, "rgb/1.png"), (2.5, "rgb/2.png")], [])
    assert [file.stamp_s for file in read_file_list(folder / "rgb.txt", rate_hz=per_second / 2)[0]] == [3.0, 5.0]


@pytest.mark.parametrize("prefix", ["", "C:\\data\\rgb\\", "/home/someone/rgb/"])
def test_names_of_another_folder_are_found_in_that_of_the_list_and_said(folder: Path, prefix: str) -> None:
    files, warnings = read(folder, SOUND.replace("rgb/", prefix))
    assert files == [(1.5, "rgb/1.png"), (2.5, "rgb/2.png")]
    assert warnings == [f"rgb.txt: its names are not those of files; the files in {folder / 'rgb'} were taken."]


def test_names_that_exist_are_taken_as_they_are_written(folder: Path) -> None:
    for name in ("rgb/a #1.png", "rgb/b\\2.png", "#3.png", "rgb/x.png 640 480"):
        (folder / name).touch()
    files, warnings = read(folder, "1 rgb/a #1.png\n2 rgb/b\\2.png\n3 #3.png\n4 rgb/x.png 640 480\n")
    assert [name for _, name in files] == ["rgb/a #1.png", "rgb/b\\2.png", "#3.png", "rgb/x.png 640 480"]
    assert warnings == []


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        (
            "1,5,rgb/1.png\n",
            ":1: '5,rgb/1.png' is no file (write stamps with a decimal point, the file next, and quotes around a name "
            "with spaces)",
        ),
        (
            "time ms,file\n1,rgb/1.png\n",
            ":1: stamps are 'time ms' (write them in seconds, or name their unit as in stamp_ms)",
        ),
        ("rgb/1.png 1.5\n", ":1: 'rgb/1.png' is not a stamp in seconds (begin the line with the time in seconds, such"),
        ("1e100 rgb/1.png\n", ":1: '1e100' is not a stamp in seconds"),
        ("1.5 rgb/1.png\n2.5 rgb/\0.png\n", ":2: holds a NUL character (save it as text in UTF-8)"),
        ("1.5 ''\n", ":1: a stamp and a file are expected (one `stamp file` a line is expected)"),
    ],
)
def test_the_rest_is_refused_with_the_fix(folder: Path, text: str, reported: str) -> None:
    with pytest.raises(RecordingError, match=re.escape(f"{folder / 'rgb.txt'}{reported}")):
        read(folder, text)


def test_a_recording_whose_lists_lack_the_folders_is_read(tum_folder: Path) -> None:
    for name in ("rgb", "depth"):
        path = tum_folder / f"{name}.txt"
        path.write_text(path.read_text().replace(f"{name}/", "").replace(" ", ";"))
    recording = open_recording(tum_folder)
    assert recording.frame_count == 6
    assert sum(type(event).__name__ == "RgbdFrame" for event in recording.events()) == 6


@pytest.mark.parametrize("change", [lambda line: line.replace(" ", ";"), lambda line: line + " 0.1 0.2", str])
def test_associations_of_all_dialects_are_read(tum_folder: Path, change) -> None:
    color, depth = (
        (tum_folder / f"{name}.txt").read_text().replace(f"{name}/", "").splitlines()[1:] for name in ("rgb", "depth")
    )
    lines = [change(f"{one} {other}") for one, other in zip(color, depth, strict=True)]
    (tum_folder / "associations.txt").write_text("timestamp rgb timestamp depth\n" + "\n".join(lines))
    assert sum(type(event).__name__ == "RgbdFrame" for event in open_recording(tum_folder).events()) == 6
