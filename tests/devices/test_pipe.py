"""The telemetry pipe: readers come, dawdle and go, and the writer never waits."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from wheelsight.core.errors import DeviceError, OutputError
from wheelsight.io.devices import TelemetryPipe


class Reader:
    """Someone who has the pipe open, and reads when asked."""

    def __init__(self, path: Path) -> None:
        self._descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)

    def read(self, size: int = 1 << 22) -> bytes:
        data = b""
        while len(data) < size:
            try:
                more = os.read(self._descriptor, min(size - len(data), 1 << 16))
            except BlockingIOError:
                break
            if not more:
                break
            data += more
        return data

    def leave(self) -> None:
        os.close(self._descriptor)


@pytest.fixture
def pipe(tmp_path: Path) -> Iterator[TelemetryPipe]:
    with TelemetryPipe(tmp_path / "wheels") as made:
        yield made


def numbered(first: int, last: int, size: int = 0) -> bytes:
    return b"".join(b"%d" % n + b" " * size + b"\n" for n in range(first, last))


def test_lines_reach_a_reader(pipe: TelemetryPipe) -> None:
    reader = Reader(pipe.path)
    for n in range(10):
        pipe.send(str(n))
    assert reader.read() == numbered(0, 10)
    assert (pipe.sent, pipe.dropped, pipe.has_reader) == (10, 0, True)
    reader.leave()


def test_two_programs_on_one_pipe(pipe: TelemetryPipe) -> None:
    with pytest.raises(DeviceError, match=r"another program writes into this pipe \(end that one first\)"):
        TelemetryPipe(pipe.path)
    reader = Reader(pipe.path)
    pipe.send("1")
    assert reader.read() == b"1\n"
    reader.leave()
    pipe.close()
    with TelemetryPipe(pipe.path):
        assert pipe.path.is_fifo()
        pipe.close()  # again; the pipe is another's now
        assert pipe.path.is_fifo()
    assert list(pipe.path.parent.iterdir()) == []


def test_without_a_reader_nothing_is_kept(pipe: TelemetryPipe) -> None:
    pipe.send("old")
    reader = Reader(pipe.path)
    pipe.send("new")
    assert reader.read() == b"new\n"
    assert (pipe.sent, pipe.dropped) == (1, 0)
    reader.leave()


def test_readers_come_and_go(pipe: TelemetryPipe) -> None:
    for n in range(5):
        reader = Reader(pipe.path)
        pipe.send(f"a{n}")
        assert reader.read() == f"a{n}\n".encode()
        reader.leave()
        pipe.send("to nobody")
        pipe.send("to nobody")
        assert not pipe.has_reader


def test_a_slow_reader_gets_whole_lines_the_oldest_waiting_dropped_and_counted(pipe: TelemetryPipe) -> None:
    reader, padding = Reader(pipe.path), 400
    for n in range(5000):  # while no one reads: a writer that waits would wait for ever
        pipe.send(f"{n}" + " " * padding)
    got = reader.read()
    for n in (5000, 5001):
        pipe.send(f"{n}" + " " * padding)
        got += reader.read()
    numbers = [int(line) for line in got.splitlines()]
    assert all(len(line) == len(line.split()[0]) + padding for line in got.splitlines())
    assert numbers == sorted(set(numbers))
    assert numbers[:100] == list(range(100))
    assert numbers[-200:] == list(range(4802, 5002))
    assert pipe.dropped == 5002 - len(numbers) > 4000
    reader.leave()


def test_a_reader_that_leaves_with_lines_waiting_is_no_error(pipe: TelemetryPipe) -> None:
    reader = Reader(pipe.path)
    for _ in range(1000):
        pipe.send("x" * 1000)
    reader.leave()
    pipe.send("nobody")
    assert not pipe.has_reader
    late = Reader(pipe.path)
    pipe.send("late")
    assert late.read() == b"late\n"
    late.leave()


def test_a_blocking_reader_is_woken_at_once(pipe: TelemetryPipe) -> None:
    got: list[str] = []

    def read() -> None:
        with pipe.path.open() as stream:
            got.append(stream.readline())

    reader = threading.Thread(target=read)
    reader.start()
    while not pipe.has_reader:
        pipe.send("hello")
        time.sleep(0.005)
    reader.join(60)
    assert got == ["hello\n"]


def test_it_is_removed_at_the_end(tmp_path: Path) -> None:
    with TelemetryPipe(tmp_path / "wheels") as pipe:
        assert pipe.path.is_fifo()
    assert not pipe.path.exists()
    pipe.close()


def test_what_was_put_in_its_place_is_left_alone_and_not_written_to(tmp_path: Path) -> None:
    with TelemetryPipe(tmp_path / "wheels") as pipe:
        pipe.path.unlink()
        pipe.path.write_text("precious")
        pipe.send("line")
    assert pipe.path.read_text() == "precious"


def test_a_pipe_left_over_is_used_again(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "wheels")
    reader = Reader(tmp_path / "wheels")
    with TelemetryPipe(tmp_path / "wheels") as pipe:
        pipe.send("line")
        assert reader.read() == b"line\n"
    assert not pipe.path.exists()
    reader.leave()


def test_a_regular_file_is_refused_and_never_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    path.write_text("precious")
    with pytest.raises(OutputError, match=rf"^{path}: exists and is not a pipe \("):
        TelemetryPipe(path)
    assert path.read_text() == "precious"
    with pytest.raises(OutputError, match="is not a pipe"):
        TelemetryPipe(tmp_path)


def test_a_folder_that_is_missing(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="the folder does not exist"):
        TelemetryPipe(tmp_path / "none" / "wheels")


@pytest.mark.parametrize("line", ["two\nlines", "x" * 4096])
def test_what_cannot_go_in_whole_is_refused(pipe: TelemetryPipe, line: str) -> None:
    with pytest.raises(ValueError, match="not one line"):
        pipe.send(line)
