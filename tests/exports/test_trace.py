"""The file of a trace: events of each thread, waits for locks, and what remains of a broken or full run."""

from __future__ import annotations

import errno
import json
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import pytest

from wheelsight.core import threads
from wheelsight.core.errors import OutputError
from wheelsight.core.threads import FRAME, LOCK, Stopwatch, in_span, in_spans, new_condition, new_lock, span
from wheelsight_export import trace, trace_to
from wheelsight_export.trace import TraceFile


def events_in(path: Path) -> list[dict[str, Any]]:
    events: list[dict[str, Any]] = json.loads(path.read_text())["traceEvents"]
    return events


def named(events: list[dict[str, Any]], name: str) -> dict[str, Any]:
    (event,) = (event for event in events if event["name"] == name)
    return event


def is_inside(inner: dict[str, Any], outer: dict[str, Any]) -> bool:
    after = inner["ts"] + inner["dur"] <= outer["ts"] + outer["dur"] + 0.2
    return bool(inner["tid"] == outer["tid"] and outer["ts"] <= inner["ts"] + 0.2 and after)


def test_stages_and_laps_are_in_the_frame_of_their_thread(tmp_path: Path) -> None:
    watch = Stopwatch()
    with trace_to(tmp_path / "trace.json"):
        with span("frame", FRAME, stamp_s=1.5):
            watch.begin_frame()
            watch.lap("first")
            with watch.stage("outer"), watch.stage("inner"):
                sum(range(1000))
            watch.lap("last", ends_frame=True)
        with ThreadPoolExecutor(1, "beside") as pool:
            pool.submit(in_span, "elsewhere", list).result(60)
        assert list(in_spans("item", iter([1, 2]))) == [1, 2]
    events = events_in(tmp_path / "trace.json")
    frame = named(events, "frame")
    assert (frame["cat"], frame["args"]["stamp_s"]) == ("frame", 1.5)
    for name in ("first", "outer", "inner", "last"):
        assert is_inside(named(events, name), frame)
        assert named(events, name)["tdur"] >= 0
    assert is_inside(named(events, "inner"), named(events, "outer"))
    assert not is_inside(named(events, "elsewhere"), frame)
    names = {event["tid"]: event["args"]["name"] for event in events if event["name"] == "thread_name"}
    assert (names[frame["tid"]], names[named(events, "elsewhere")["tid"]]) == ("main", "beside_0")
    counter = named(events, "a frame waits for, ms")
    assert counter["ph"] == "C"
    assert counter["args"].keys() == {"locks", "a processor", "unexplained"}
    assert sum(event["name"] == "item" for event in events) == 3  # the end is waited for, too


def test_waits_for_locks_are_events_and_no_unexplained_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    is_held, may_go = threading.Event(), threading.Event()

    def span_of_a_wait(name: str, category: str) -> AbstractContextManager[object]:
        may_go.set()  # who holds the lock does so until another thread waits for it
        return span(name, category)

    monkeypatch.setattr(trace, "span", span_of_a_wait)
    with trace_to(tmp_path / "trace.json"):
        lock, changed = new_lock("store"), new_condition("queue")

        def hold() -> None:
            with lock:
                is_held.set()
                may_go.wait(60)

        with ThreadPoolExecutor(1) as pool:
            holding = pool.submit(hold)
            is_held.wait(60)
            with span("work"), lock:
                pass
            holding.result(60)
        with changed:
            assert not changed.wait(0.01)
    events = events_in(tmp_path / "trace.json")
    waited, work = named(events, "store"), named(events, "work")
    assert waited["cat"] == named(events, "queue: wait")["cat"] == LOCK
    assert is_inside(waited, work)
    assert abs(work["args"]["locks_us"] - waited["dur"]) < 1
    assert work["args"]["unexplained_us"] <= work["dur"] - waited["dur"] + 1


def test_an_exception_leaves_a_complete_file(tmp_path: Path) -> None:
    def interrupted() -> None:
        with trace_to(tmp_path / "trace.json"):
            in_span("work", list)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert named(events_in(tmp_path / "trace.json"), "work")["ph"] == "X"
    assert [path.name for path in tmp_path.iterdir()] == ["trace.json"]


def test_a_full_disk_ends_the_trace_and_not_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done = []

    def fail(file: TraceFile) -> None:
        raise OSError(errno.ENOSPC, "no space left")

    monkeypatch.setattr(TraceFile, "finish", fail)

    def run() -> None:
        with trace_to(tmp_path / "trace.json"):
            done.append("run")

    with pytest.raises(OutputError, match=r"trace\.json: no space left on the disk \(free some space"):
        run()
    assert done == ["run"]
    assert not list(tmp_path.iterdir())


def test_a_stream_that_fails_is_reported_at_the_end() -> None:
    class Full:
        def write(self, text: str) -> int:
            raise OSError(errno.ENOSPC, "no space left")

    file = TraceFile(Full())  # type: ignore[arg-type]
    file.add("stage", (0.0, 0.0), (1.0, 0.5))
    with pytest.raises(OSError, match="no space"):
        file.finish()


def test_a_folder_that_is_missing_is_named_before_the_run(tmp_path: Path) -> None:
    with (
        pytest.raises(OutputError, match=r"none.trace\.json: the folder does not exist"),
        trace_to(tmp_path / "none" / "trace.json"),
    ):
        pytest.fail("the block ran")


def test_without_a_tracer_nothing_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    assert span("a") is span("b", LOCK, stamp_s=1.0)
    assert type(new_lock("a")) is type(threading.Lock())
    assert type(new_condition("a")) is threading.Condition
    items = iter([1])
    assert in_spans("item", items) is items
    assert vars(threads)["_tracer"] is None
