"""Outputs are whole or not there: interrupted writes, full disks, missing rights."""

from __future__ import annotations

import errno
import os
import stat
import threading
from pathlib import Path

import pytest

from wheelsight.core.errors import OutputError
from wheelsight.core.files import (
    atomic_write,
    make_output_folder,
    new_output_folder,
    output_error,
    write_bytes,
    write_text,
)


def raising(code: int):
    """A function that fails as the operating system does."""

    def fail(*_: object, **__: object) -> None:
        raise OSError(code, os.strerror(code))

    return fail


def test_text_is_utf8_with_plain_line_ends(tmp_path: Path) -> None:
    write_text(tmp_path / "a.txt", "σ(z)\nzwei\n")
    assert (tmp_path / "a.txt").read_bytes() == "σ(z)\nzwei\n".encode()


def test_text_that_no_encoding_has_is_written_all_the_same(tmp_path: Path) -> None:
    """A folder's name may hold bytes that are no text, and stands in reports."""
    write_text(tmp_path / "a.txt", "σ \udcff")
    assert (tmp_path / "a.txt").read_text(encoding="utf-8") == "σ \\udcff"


def test_bytes_come_back(tmp_path: Path) -> None:
    write_bytes(tmp_path / "a.bin", bytes(range(256)))
    assert (tmp_path / "a.bin").read_bytes() == bytes(range(256))


@pytest.mark.parametrize("name", ["/", ".", ".."])
def test_a_folder_is_no_place_for_a_file(name: str) -> None:
    with pytest.raises(OutputError, match="is a folder, not a file"):
        write_text(Path(name), "text")


def test_a_pipe_or_device_is_not_replaced(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "null").symlink_to("/dev/null")
    for name in ("pipe", "null"):
        with pytest.raises(OutputError, match="is a device or a pipe, not a file"):
            write_text(tmp_path / name, "text")
    assert (tmp_path / "pipe").is_fifo()
    assert (tmp_path / "null").is_symlink()


def test_nothing_but_the_file_stays(tmp_path: Path) -> None:
    write_text(tmp_path / "a.txt", "one")
    write_text(tmp_path / "a.txt", "two")
    assert (tmp_path / "a.txt").read_text() == "two"
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]


def test_the_file_is_not_there_before_it_is_whole(tmp_path: Path) -> None:
    with atomic_write(tmp_path / "a.txt") as stream:
        stream.write("half")
        stream.flush()
        assert not (tmp_path / "a.txt").exists()
    assert (tmp_path / "a.txt").exists()


@pytest.mark.parametrize("interruption", [KeyboardInterrupt, RuntimeError, MemoryError])
def test_an_interrupted_write_leaves_the_old_file(tmp_path: Path, interruption: type[BaseException]) -> None:
    write_text(tmp_path / "a.txt", "old")

    def interrupted_write() -> None:
        with atomic_write(tmp_path / "a.txt") as stream:
            stream.write("new")
            raise interruption

    with pytest.raises(interruption):
        interrupted_write()
    assert (tmp_path / "a.txt").read_text() == "old"
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize(("code", "message"), [(errno.ENOSPC, "no space left"), (errno.EDQUOT, "quota is used up")])
def test_a_full_disk_at_the_flush_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int, message: str
) -> None:
    write_text(tmp_path / "a.txt", "old")
    monkeypatch.setattr(os, "fsync", raising(code))
    with pytest.raises(OutputError, match=message) as caught:
        write_text(tmp_path / "a.txt", "new")
    assert caught.value.path == tmp_path / "a.txt"
    assert caught.value.fix
    assert (tmp_path / "a.txt").read_text() == "old"
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
def test_a_truly_full_device_is_an_output_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    really_open = Path.open
    monkeypatch.setattr(Path, "open", lambda _self, _mode, **_: really_open(Path("/dev/full"), "wb"))
    with pytest.raises(OutputError, match="no space left"):
        write_bytes(tmp_path / "a.bin", b"data")


def test_a_failing_move_leaves_no_rest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Path, "replace", raising(errno.EROFS))
    with pytest.raises(OutputError, match="read-only"):
        write_text(tmp_path / "a.txt", "new")
    assert not list(tmp_path.iterdir())


def test_a_folder_without_permission(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Path, "open", raising(errno.EACCES))  # root may write everywhere, so the refusal is played
    with pytest.raises(OutputError, match=r"a\.txt: no permission to write here \(choose a folder you own\)"):
        write_text(tmp_path / "a.txt", "new")


def test_a_missing_folder(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="does not exist"):
        write_text(tmp_path / "nowhere" / "a.txt", "new")


def test_a_file_where_a_folder_should_be(tmp_path: Path) -> None:
    write_text(tmp_path / "a", "file")
    with pytest.raises(OutputError, match="a file, not a folder"):
        write_text(tmp_path / "a" / "b.txt", "new")


def test_a_folder_where_the_file_should_be(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    with pytest.raises(OutputError, match="a folder, not a file"):
        write_text(tmp_path / "a", "new")
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


@pytest.mark.parametrize("umask", [0o022, 0o077])
def test_permissions_are_those_of_any_new_file(tmp_path: Path, umask: int) -> None:
    before = os.umask(umask)
    try:
        write_text(tmp_path / "a.txt", "new")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a.txt").stat().st_mode) == 0o666 & ~umask


def test_a_reader_never_sees_half_a_file(tmp_path: Path) -> None:
    path, size = tmp_path / "a.txt", 200_000
    write_text(path, "0" * size)
    seen: set[str] = set()
    finished = threading.Event()

    def read() -> None:
        while not finished.is_set():
            text = path.read_text()
            seen.add(f"{len(text)} of {sorted(set(text))}")

    reader = threading.Thread(target=read)
    reader.start()
    for digit in "123456789" * 3:
        write_text(path, digit * size)
    finished.set()
    reader.join()
    assert seen <= {f"{size} of {[digit]}" for digit in "0123456789"}


def test_an_output_folder_is_made_with_its_parents(tmp_path: Path) -> None:
    assert make_output_folder(tmp_path / "a" / "b") == tmp_path / "a" / "b"
    assert not list((tmp_path / "a" / "b").iterdir())


def test_an_empty_output_folder_may_be_there(tmp_path: Path) -> None:
    make_output_folder(tmp_path)


def test_a_used_output_folder_is_kept_unless_forced(tmp_path: Path) -> None:
    write_text(tmp_path / "trajectory.txt", "old")
    with pytest.raises(OutputError, match=r"is not empty \(.*--force"):
        make_output_folder(tmp_path)
    make_output_folder(tmp_path, force=True)
    assert (tmp_path / "trajectory.txt").read_text() == "old"


def test_an_output_folder_that_is_a_file(tmp_path: Path) -> None:
    write_text(tmp_path / "a", "file")
    with pytest.raises(OutputError, match="a file, not a folder"):
        make_output_folder(tmp_path / "a", force=True)
    with pytest.raises(OutputError, match="a file, not a folder"):
        make_output_folder(tmp_path / "a" / "b")


def test_an_output_folder_that_cannot_be_written_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wheelsight.core.files.tempfile.TemporaryFile", raising(errno.EACCES))
    with pytest.raises(OutputError, match="no permission"):
        make_output_folder(tmp_path)


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="this system has no /proc")
def test_an_output_folder_where_no_one_can_make_one() -> None:
    with pytest.raises(OutputError, match="does not exist and cannot be made"):
        make_output_folder(Path("/proc/wheelsight"))
    with pytest.raises(OutputError, match="/proc"):
        make_output_folder(Path("/proc"), force=True)


def test_an_unusual_error_keeps_the_systems_words(tmp_path: Path) -> None:
    error = output_error(OSError(errno.EIO, os.strerror(errno.EIO)), tmp_path)
    assert os.strerror(errno.EIO) in str(error)


@pytest.mark.parametrize("holds", [False, True])
def test_a_folder_of_refused_work_is_removed_as_far_as_it_was_made_and_is_empty(tmp_path: Path, holds: bool) -> None:
    mine = tmp_path / "mine"
    mine.mkdir()

    def refused() -> None:
        with new_output_folder(mine / "new" / "out") as out:
            assert out.is_dir()
            if holds:
                (out.parent / "note.txt").touch()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        refused()
    assert [path.name for path in mine.rglob("*")] == (["new", "note.txt"] if holds else [])


def test_a_folder_that_was_there_stays_whatever_is_refused(tmp_path: Path) -> None:
    (tmp_path / "note.txt").touch()
    with pytest.raises(OutputError), new_output_folder(tmp_path):
        pass
    assert (tmp_path / "note.txt").is_file()


def test_a_folder_of_work_that_is_done_stays(tmp_path: Path) -> None:
    with new_output_folder(tmp_path / "new" / "out"):
        pass
    assert (tmp_path / "new" / "out").is_dir()
