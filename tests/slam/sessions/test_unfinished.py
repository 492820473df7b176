"""What is on the disk at each moment of a command that writes a map: it says that it is no whole one, or is one.

A kill leaves what is on the disk at that moment. So the folder is copied before each file that is opened, renamed or
removed, and after each record.
"""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from grids import mostly_slow
from sessions.kept_views import CALIBRATION, COUNT, write_map
from sessions.mounted_maps import WAY, drive
from sessions.seen_maps import RING, aside, write_seen

from wheelsight.core.errors import MapError, OutputError
from wheelsight.core.settings import RecognitionSettings
from wheelsight.slam.maps import DRIVE, MapFolder, discard_map, find_map, info_of, merge, prune, rebuild
from wheelsight.slam.maps.folder import MapLock
from wheelsight.slam.maps.journal import MERGE, JournalWriter, Record, read_header

RECOGNITION = RecognitionSettings()
EVENTS = ("open", "os.rename", "os.remove", "os.mkdir", "os.rmdir")
_watchers: list[Callable[[], None]] = []


def _hook(event: str, arguments: tuple[Any, ...]) -> None:
    if _watchers and event in EVENTS:
        _watchers[-1]()


sys.addaudithook(_hook)


@contextmanager
def moments(out: Path, kept: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[list[Path]]:
    """Copies of a folder as it is at each moment of the block, each unlike the one before."""
    copies: list[Path] = []
    state = [""]

    def keep() -> None:
        watchers, _watchers[:] = _watchers[:], []  # what follows opens files, too
        try:
            reported = str([(file.name, file.stat().st_size) for file in sorted(out.glob("*"))])
            if out.exists() and reported != state[0]:
                state[0] = reported
                copies.append(Path(shutil.copytree(out, kept / str(len(copies)))))
        finally:
            _watchers[:] = watchers

    append = JournalWriter.append

    def append_and_keep(self: JournalWriter, kind: int, key: int, content: bytes) -> Record:
        record = append(self, kind, key, content)
        keep()
        return record

    with monkeypatch.context() as patch:
        patch.setattr(JournalWriter, "append", append_and_keep)
        _watchers.append(keep)
        try:
            yield copies
        finally:
            _watchers.clear()


def two_maps(folder: Path) -> tuple[MapFolder, MapFolder]:
    write_seen(folder / "first", RING[:3])
    write_seen(folder / "second", [aside(T, 0.03) for T in RING[:3]], begin_s=100.0)
    return MapFolder.open(folder / "first"), MapFolder.open(folder / "second")


COMMANDS: dict[str, Callable[[MapFolder, MapFolder, Path], object]] = {
    "merge": lambda first, second, out: merge(first, second, out, recognition=RECOGNITION),
    "prune": lambda first, second, out: prune(first, out, RECOGNITION),
    "rebuild": lambda first, second, out: rebuild(first, out, recognition=RECOGNITION),
}


@pytest.mark.parametrize("command", mostly_slow(COMMANDS, ["prune"]))
def test_at_each_moment_of_a_command_its_map_says_that_it_is_incomplete(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    first, second = two_maps(tmp_path)
    out = tmp_path / "out"
    with moments(out, tmp_path / "moments", monkeypatch) as copies:
        COMMANDS[command](first, second, out)
    assert len(copies) > 12
    assert info_of(MapFolder.open(out)).health.notes == ()
    assert sorted(file.name for file in out.iterdir() if file.name.startswith(".")) == []
    reported = 0
    for at, copy in enumerate(copies):
        if (copy / "map.json").exists() and at < len(copies) - 1:
            with pytest.raises(MapError, match=rf"is incomplete: {command} was ended \(run it again\)"):
                MapFolder.open(copy)
            health = info_of(MapFolder.open(copy, is_incomplete_read=True)).health
            assert not health.is_whole
            assert health.notes[0] == f"The map is incomplete: {command} was ended; run it again."
            reported += 1
    assert reported > 8
    for copy in copies[:-1:6]:
        made = COMMANDS[command](first, second, copy)
        assert made is not None
        assert MapFolder.open(copy).contents.health.is_whole
        assert {file.name for file in copy.iterdir()} == {file.name for file in out.iterdir()}


def test_at_each_moment_of_a_drive_its_map_says_that_it_was_cut_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "map"
    with moments(out, tmp_path / "moments", monkeypatch) as copies:
        drive(out, WAY[:3]).close()
    assert info_of(MapFolder.open(out)).health.notes == ()
    opened = [copy for copy in copies[:-1] if read_unfinished(copy) == DRIVE]
    assert len(opened) > 8
    for copy in opened:
        health = MapFolder.open(copy).contents.health
        assert health.is_whole
        assert health.notes[0].startswith("The drive was ended before its map was finished")
    counts = [len(MapFolder.open(copy).store) for copy in opened]
    assert counts == sorted(counts)
    assert counts[-1] == 3


def read_unfinished(path: Path) -> str | None:
    return json.loads((path / "map.json").read_text()).get("unfinished") if (path / "map.json").exists() else None


def test_a_drive_that_extends_a_map_marks_it_until_it_is_over(tmp_path: Path) -> None:
    write_map(tmp_path / "map", 3)
    folder = MapFolder.open(tmp_path / "map", read_only=False)
    folder.begin(DRIVE)
    assert MapFolder.open(tmp_path / "map").contents.health.notes == ("A drive still writes it.",)
    folder.close()
    (note,) = MapFolder.open(tmp_path / "map").contents.health.notes
    assert note.startswith("The drive was ended")
    folder = MapFolder.open(tmp_path / "map", read_only=False)
    folder.finish()
    folder.close()
    assert MapFolder.open(tmp_path / "map").contents.health.notes == ()


@pytest.mark.parametrize("command", mostly_slow(COMMANDS, ["prune"]))
def test_a_command_that_fails_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str) -> None:
    """Ctrl-C, or a full disk, in the midst of writing."""
    first, second = two_maps(tmp_path)
    for problem in (KeyboardInterrupt(), OutputError("no space left on the disk")):

        def fail(*given: Any, problem: BaseException = problem) -> None:
            raise problem

        monkeypatch.setattr(MapFolder, "save_recognition", fail)
        with pytest.raises(type(problem)):
            COMMANDS[command](first, second, tmp_path / "out")
        assert not (tmp_path / "out").exists()


def test_a_map_that_is_being_made_is_not_taken_away(tmp_path: Path) -> None:
    first, _ = two_maps(tmp_path)
    out = tmp_path / "out"
    new = MapFolder.create(out, first.calibration, unfinished=MERGE)
    with pytest.raises(MapError, match="is incomplete: merge is still making it"):
        MapFolder.open(out)
    with pytest.raises(MapError, match=r"another run, of process [0-9]+, writes this map"):
        prune(first, out)
    new.close()
    assert not MapLock.is_held(out)
    assert find_map(out) == out


def test_only_what_was_left_unfinished_goes(tmp_path: Path) -> None:
    """Not a map of a drive that was cut off, nor one whose map.json is missing or damaged, nor files of others."""
    first, _ = two_maps(tmp_path)
    MapFolder.create(tmp_path / "drive", CALIBRATION, unfinished=DRIVE).close()
    write_map(tmp_path / "headless", 2)
    (tmp_path / "headless" / "map.json").unlink()
    write_map(tmp_path / "damaged", 2)
    (tmp_path / "damaged" / "map.json").write_text("{")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "calibration.yaml").write_text("mine")
    MapFolder.create(tmp_path / "mixed", CALIBRATION, unfinished=MERGE).close()
    (tmp_path / "mixed" / "notes.txt").write_text("mine")
    for name in ("drive", "headless", "damaged", "other", "mixed"):
        before = {file.name: file.read_bytes() for file in (tmp_path / name).iterdir()}
        with pytest.raises(OutputError, match="is not empty"):
            prune(first, tmp_path / name)
        after = {file.name: file.read_bytes() for file in (tmp_path / name).iterdir()}
        assert after == ({"notes.txt": b"mine"} if name == "mixed" else before)


def test_a_removal_that_is_ended_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "map"
    write_map(path, COUNT)
    with moments(path, tmp_path / "moments", monkeypatch) as copies:
        discard_map(path)
    assert not path.exists()
    assert read_header(copies[0]).unfinished == ""
    for copy in copies:
        if (copy / "map.json").exists() and read_unfinished(copy):
            with pytest.raises(MapError, match="is incomplete: removal was ended"):
                MapFolder.open(copy)
        discard_map(copy)
        assert not copy.exists() or not any(copy.iterdir())
