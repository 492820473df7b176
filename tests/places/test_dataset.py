"""Drives with labels: whichever source shows them, they agree; what does not belong together is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from places.made import NAMES, QUICK, SMALL_HISTOGRAMS, frame_of
from places.made_recording import rooms, straight, write_drive
from stand_ins import MemoryRecording

from wheelsight.core.areas import AreaMap, save_areas
from wheelsight.core.errors import AreaError, PlaceError
from wheelsight.core.messages import Event, SkippedFrame, WheelTicks
from wheelsight.io.recordings import open_recording
from wheelsight.places import ForestSettings
from wheelsight_papers import (
    check_every_area,
    describe_drive,
    frames_of,
    label_source,
    names_of_all,
    read_labels,
    stamps_of,
    train_on_drives,
)

TRUE = [0] * 20 + [1] * 20 + [2] * 20


def test_polygons_frames_and_ranges_tell_the_same(tmp_path: Path) -> None:
    recording = open_recording(write_drive(tmp_path / "drive", with_labels=True))
    ranges = tmp_path / "ranges.csv"
    ranges.write_text("from_s,to_s,area\n0,1.95,corridor\n1.95,3.95,hall\n3.95,6,lift\n")
    sources = [
        label_source(recording),
        label_source(recording, read_labels(recording.path / "labels.csv")),
        label_source(recording, read_labels(ranges)),
    ]
    for source in sources:
        assert source.of_frames(stamps_of(recording), NAMES).tolist() == TRUE
    reported = [source.description for source in sources]
    assert reported == ["areas.yaml and trajectory", "labels.csv", "ranges.csv"]


def test_its_own_labels_serve_where_polygons_or_truth_are_missing(tmp_path: Path) -> None:
    bare = open_recording(write_drive(tmp_path / "a", with_areas=False, with_labels=True))
    assert label_source(bare).description == "labels.csv"
    assert label_source(bare).names == NAMES
    lost = open_recording(write_drive(tmp_path / "b", with_truth=False, with_labels=True))
    assert label_source(lost).of_frames(stamps_of(lost), NAMES).tolist() == TRUE
    nothing = open_recording(write_drive(tmp_path / "c", with_areas=False))
    assert (label_source(nothing).description, label_source(nothing).names) == ("", ())
    assert set(label_source(nothing).of_frames(stamps_of(nothing), NAMES).tolist()) == {-1}


def test_another_trajectory_goes_before_the_truth(tmp_path: Path) -> None:
    recording = open_recording(write_drive(tmp_path / "drive"))
    stamps_s = np.array(stamps_of(recording))
    source = label_source(recording, trajectory=straight(stamps_s, np.full(60, 4.0)))
    assert source.of_frames(stamps_s.tolist(), NAMES).tolist() == [1] * 60


def test_names_in_another_order_keep_their_meaning(tmp_path: Path) -> None:
    recording = open_recording(write_drive(tmp_path / "drive"))
    labels = label_source(recording).of_frames(stamps_of(recording), ("lift", "corridor", "hall"))
    assert labels.tolist() == [1] * 20 + [2] * 20 + [0] * 20


def test_an_area_that_is_not_asked_for_is_refused(tmp_path: Path) -> None:
    recording = open_recording(write_drive(tmp_path / "drive"))
    with pytest.raises(AreaError, match=r"areas\.yaml: area 'lift' is not known here \(known: corridor, hall\)"):
        label_source(recording).of_frames(stamps_of(recording), ("corridor", "hall"))


def test_labels_must_be_of_the_areas_there_are(tmp_path: Path) -> None:
    recording = open_recording(write_drive(tmp_path / "drive"))
    (tmp_path / "l.csv").write_text("from_s,to_s,area\n0,1,hal\n")
    with pytest.raises(AreaError, match=r"l\.csv:2: there is no area 'hal' \(did you mean hall\?\)"):
        label_source(recording, read_labels(tmp_path / "l.csv"))


def test_areas_of_several_drives_must_agree(tmp_path: Path) -> None:
    first, second = (open_recording(write_drive(tmp_path / name)) for name in "ab")
    assert names_of_all([label_source(first), label_source(second)]) == NAMES
    save_areas(AreaMap(tuple(rooms())[:2]), second.path / "areas.yaml")
    with pytest.raises(AreaError, match=r"b/areas\.yaml: has areas corridor, hall, but .*a/areas\.yaml corridor, hall"):
        names_of_all([label_source(first), label_source(second)])


def test_names_are_all_that_labels_name_where_there_are_no_polygons(tmp_path: Path) -> None:
    drives = []
    for name, area in (("a", "room 10"), ("b", "room 9")):
        drives.append(open_recording(write_drive(tmp_path / name, with_areas=False)))
        (tmp_path / f"{name}.csv").write_text(f"from_s,to_s,area\n0,1,{area}\n")
    sources = [label_source(d, read_labels(tmp_path / f"{d.name}.csv")) for d in drives]
    assert names_of_all(sources) == ("room 9", "room 10")


def test_an_area_without_frames_is_named_with_its_file() -> None:
    check_every_area([np.array([0, -1]), np.array([1])], ("a", "b"), None)
    with pytest.raises(AreaError, match=r"l\.csv: area 'b' has no training frames \(drive through it, or leave"):
        check_every_area([np.array([0, -1])], ("a", "b"), Path("l.csv"))
    with pytest.raises(AreaError, match="1 areas cannot be distinguished"):
        check_every_area([np.array([0])], ("a",), None)


def test_frames_without_depth_and_skipped_ones_teach_nothing(tmp_path: Path, rng: np.random.Generator) -> None:
    folder = write_drive(tmp_path / "drive", blind=(3,))
    sorted((folder / "rgb").iterdir())[10].write_bytes(b"no image")
    recording, listed = open_recording(folder), []
    drive = describe_drive(recording, label_source(recording), NAMES, SMALL_HISTOGRAMS, lambda: listed.append(1))
    assert drive.labels.tolist() == [0] * 3 + [-1] + [0] * 15 + [1] * 20 + [2] * 20
    assert (len(listed), drive.frames.features.shape) == (60, (59, SMALL_HISTOGRAMS.size))


def test_stamps_of_what_is_no_folder_of_images(rng: np.random.Generator) -> None:
    events: list[Event] = [
        frame_of(0, rng, 0.5),
        WheelTicks(0.6, 1, 1),
        SkippedFrame(1.0, "dark", 1),
        frame_of(0, rng, 1.5),
    ]
    recording = MemoryRecording(events)
    assert stamps_of(recording) == [0.5, 1.0, 1.5]
    assert [frame.stamp_s for frame in frames_of(recording)] == [0.5, 1.5]


def test_a_model_learns_from_all_drives_and_holds_out_each(tmp_path: Path) -> None:
    recordings = [open_recording(write_drive(tmp_path / f"{seed}", seed=seed)) for seed in (1, 2)]
    drives = [describe_drive(r, label_source(r), NAMES, SMALL_HISTOGRAMS) for r in recordings]
    model = train_on_drives(drives, NAMES, SMALL_HISTOGRAMS, QUICK)
    assert model.frame_size == (24, 32, 24, 32)
    assert model.area_shares.tolist() == pytest.approx([1 / 3] * 3)
    assert len(model.figures.area_accuracy) == 3
    assert np.mean(model.figures.area_accuracy) == pytest.approx(model.figures.accuracy)


def test_a_single_drive_is_held_out_by_seconds_whatever_its_rate(tmp_path: Path) -> None:
    recording = open_recording(write_drive(tmp_path / "drive"))
    drive = describe_drive(recording, label_source(recording), NAMES, SMALL_HISTOGRAMS)
    settings = train_on_drives([drive], NAMES, SMALL_HISTOGRAMS, ForestSettings(trees=4, folds=2)).settings
    assert (settings.block_frames, settings.gap_frames) == (10, 2)  # of 10 Hz
    slow = replace(drive, frames=replace(drive.frames, stamps_s=4 * drive.frames.stamps_s))
    settings = train_on_drives([slow], NAMES, SMALL_HISTOGRAMS, ForestSettings(trees=4, folds=2)).settings
    assert (settings.block_frames, settings.gap_frames) == (2, 1)
    reported = ForestSettings(trees=4, folds=2, block_frames=7)
    assert train_on_drives([slow], NAMES, SMALL_HISTOGRAMS, reported).settings.block_frames == 7


def test_drives_of_different_images_do_not_go_together(tmp_path: Path, rng: np.random.Generator) -> None:
    recording = open_recording(write_drive(tmp_path / "drive"))
    drive = describe_drive(recording, label_source(recording), NAMES, SMALL_HISTOGRAMS)
    large = MemoryRecording([frame_of(0, rng, 0.0, (48, 64))], name="large")
    other = describe_drive(large, label_source(large), NAMES, SMALL_HISTOGRAMS)
    with pytest.raises(PlaceError, match="large has images of another size than drive"):
        train_on_drives([drive, other], NAMES, SMALL_HISTOGRAMS, QUICK)
