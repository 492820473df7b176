"""What is no ordinary file, or larger than its kind, is reported in one line and never opened."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest

from wheelsight.core.errors import RecordingError
from wheelsight.core.inputs import Kind, lines_of, read_bytes, read_text

KIND = Kind("a list", most_mb=1, most_lines=10, missing="is missing", fix="each recording needs it")


def refused(path: Path, problem: str) -> None:
    with pytest.raises(RecordingError) as caught:
        read_bytes(path, KIND, RecordingError)
    assert str(caught.value).startswith(f"{path}: {problem}")


def test_an_ordinary_file_and_a_link_to_one_are_read(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"text")
    (tmp_path / "b").symlink_to("a")
    assert (
        read_bytes(tmp_path / "a", KIND, RecordingError) == read_bytes(tmp_path / "b", KIND, RecordingError) == b"text"
    )


@pytest.mark.timeout(60)
def test_a_pipe_that_no_one_writes_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("pipe")
    for name in ("pipe", "link"):
        refused(tmp_path / name, "is a pipe, not a file (give an ordinary file)")


def test_folders_and_sockets_are_no_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    refused(tmp_path, "is a folder, not a file")
    monkeypatch.chdir(tmp_path)  # a socket's name may not be long
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind("socket")
        refused(Path("socket"), "is a socket, not a file")


@pytest.mark.timeout(60)
@pytest.mark.parametrize("name", ["/dev/zero", "/dev/null", "/proc/self/mem", "/proc/self/status", "/proc/kmsg"])
def test_devices_and_what_the_kernel_makes_up_are_no_files(name: str, tmp_path: Path) -> None:
    if not Path(name).exists():
        pytest.skip(f"{name} is not there")
    (tmp_path / "list.txt").symlink_to(name)
    refused(tmp_path / "list.txt", "is a device" if name.startswith("/dev") else "is no file on a disk")


def test_a_file_of_ten_gigabytes_is_reported_by_its_size(tmp_path: Path) -> None:
    with (tmp_path / "sparse").open("wb") as stream:
        stream.truncate(10 << 30)
    refused(tmp_path / "sparse", "holds 10240 MB, more than a list may: 1 MB (is it the right file?)")


def test_what_is_not_there_is_reported_as_its_kind_says(tmp_path: Path) -> None:
    refused(tmp_path / "none", "is missing (each recording needs it)")
    (tmp_path / "nowhere").symlink_to("none")
    refused(tmp_path / "nowhere", "is missing")
    (tmp_path / "itself").symlink_to("itself")
    refused(tmp_path / "itself", "cannot be read: Too many levels of symbolic links")
    refused(tmp_path / ("a" * 300), "cannot be read: File name too long")


def test_names_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="is no name of a file"):
        read_bytes(tmp_path / "a\0b", KIND, RecordingError)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_text_is_read_with_its_byte_order_mark(tmp_path: Path, encoding: str) -> None:
    (tmp_path / "a").write_bytes("1.0 größe\r\n".encode(encoding))
    assert read_text(tmp_path / "a", KIND, RecordingError) == "1.0 größe\r\n"


@pytest.mark.parametrize(
    ("data", "problem"),
    [
        (b"\xff\x00\xfe", ": is not a text file (save it as text in UTF-8)"),
        ("größe".encode("latin-1"), ": is not a text file (save it as text in UTF-8)"),
        (b"a\nb\nc\0", ":3: holds a NUL character (save it as text in UTF-8)"),
        ("a\n".encode("utf-16-le"), ":1: holds a NUL character (save it as text in UTF-8)"),
        (b"\n" * 11, ": has more lines than a list may have: 10 (split it)"),
        (b"1\n" + b"2" * 70_000, ":2: is longer than 65536 characters (is it text?)"),
        (b"\r" * 11, ": has more lines than a list may have: 10 (split it)"),
    ],
)
def test_what_is_no_text_is_reported(tmp_path: Path, data: bytes, problem: str) -> None:
    (tmp_path / "a").write_bytes(data)
    with pytest.raises(RecordingError) as caught:
        read_text(tmp_path / "a", KIND, RecordingError)
    assert str(caught.value) == f"{tmp_path / 'a'}{problem}"


def test_lines_end_as_in_editors() -> None:
    assert lines_of("a\r\nb\rc\nd\x0be\u2028f") == ["a", "b", "c", "d\x0be\u2028f"]
