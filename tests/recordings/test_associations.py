"""Ready lists of pairs: names show which image of two is depth, else the images do, else they are refused."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest
from narrowing import of_type

from wheelsight.core.errors import RecordingError
from wheelsight.io.recordings import open_recording
from wheelsight.io.recordings.image_recording import ImageRecording


def columns(folder: Path) -> tuple[list[str], list[str]]:
    """Lines `stamp file` of colour and of depth."""
    color, depth = ((folder / f"{name}.txt").read_text().splitlines()[1:] for name in ("rgb", "depth"))
    return color, depth


def write(folder: Path, first: list[str], second: list[str], head: str = "") -> None:
    lines = [f"{one} {other}\n" for one, other in zip(first, second, strict=True)]
    (folder / "associations.txt").write_text(head + "".join(lines))


def frames(folder: Path) -> list[tuple[float, str, str]]:
    recording = of_type(ImageRecording, open_recording(folder))
    assert sum(type(event).__name__ == "RgbdFrame" for event in recording.events()) == 6
    return [(frame.stamp_s, frame.color.name, frame.depth.name) for frame in recording.frames]


@pytest.fixture
def expected(tum_folder: Path) -> list[tuple[float, str, str]]:
    color, depth = columns(tum_folder)
    write(tum_folder, color, depth)
    return frames(tum_folder)


@pytest.mark.parametrize("prefix", ["", "./", "run_color/", "rgbd-set/", "depth_and_rgb/"])
def test_depth_first_is_reported_by_folders(tum_folder: Path, expected: list, prefix: str) -> None:
    for name in ("rgb", "depth"):
        (tum_folder / prefix / name).parent.mkdir(exist_ok=True)
        if prefix.strip("./"):
            shutil.copytree(tum_folder / name, tum_folder / prefix / name)
    color, depth = ([line.replace(" ", f" {prefix}") for line in lines] for lines in columns(tum_folder))
    write(tum_folder, depth, color)
    assert frames(tum_folder) == expected


def renamed(folder: Path, names: dict[str, str]) -> tuple[list[str], list[str]]:
    """Both columns, of images copied to folders of other names."""
    for name, to in names.items():
        shutil.copytree(folder / name, folder / to)
    color, depth = columns(folder)
    return [line.replace("rgb/", f"{names['rgb']}/") for line in color], [
        line.replace("depth/", f"{names['depth']}/") for line in depth
    ]


@pytest.mark.parametrize(
    "names",
    [
        {"rgb": "image_0", "depth": "image_1"},
        {"rgb": "depth_a", "depth": "depth_b"},
        {"rgb": "cam", "depth": "Depth"},
        {"rgb": "Color", "depth": "z"},
    ],
)
@pytest.mark.parametrize("is_depth_first", [True, False])
def test_else_the_images_tell(tum_folder: Path, expected: list, names: dict[str, str], is_depth_first: bool) -> None:
    color, depth = renamed(tum_folder, names)
    write(tum_folder, *((depth, color) if is_depth_first else (color, depth)))
    assert frames(tum_folder) == expected


def test_what_nothing_shows_is_refused_with_the_fix(tum_folder: Path) -> None:
    color, _ = renamed(tum_folder, {"rgb": "a", "depth": "b"})
    write(tum_folder, color, color, "# two images a line\n")
    reported = "associations.txt:2: neither names nor images show which of the two is depth (put depth images"
    with pytest.raises(RecordingError, match=re.escape(reported)):
        open_recording(tum_folder)


def test_stamps_count_what_the_first_line_names(tum_folder: Path, expected: list) -> None:
    def in_ms(lines: list[str]) -> list[str]:
        return [f"{1000 * float(line.split()[0]):.3f} {line.split()[1]}" for line in lines]

    color, depth = columns(tum_folder)
    write(tum_folder, in_ms(depth), in_ms(color), "# timestamp_ms depth timestamp_ms rgb\n")
    assert [found[1:] for found in frames(tum_folder)] == [known[1:] for known in expected]
    assert [found[0] for found in frames(tum_folder)] == pytest.approx([known[0] for known in expected], abs=1e-6)
