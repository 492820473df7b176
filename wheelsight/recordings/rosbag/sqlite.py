"""Files of ROS 2's sqlite3 storage, `.db3`.

A database is a program, too: tables that compute their values can make gigabytes of a few bytes, and pages that refer
to each other can be walked over for ever. Plain tables alone are read, in a bounded number of steps.
"""

from __future__ import annotations

import re
import sqlite3
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Self

from wheelsight.errors import RecordingError
from wheelsight.inputs import open_binary
from wheelsight.recordings.rosbag.chunks import BAG, Allowance
from wheelsight.recordings.rosbag.definitions import LONGEST_DEFINITION, MOST_CONNECTIONS, Connection

_LANGUAGES = {"ros2msg": "MSG", "ros2idl": "IDL"}
_LONGEST_VALUE = 128 << 20  # bytes, of a message
_MOST_SCHEMA = 1000  # tables and indexes; a bag has some ten
# Steps of sqlite's machine in one question. A row takes some ten steps, and twenty bytes of the file at least.
_FREE_STEPS, _STEPS_A_BYTE, _LOOK_STEPS = 10_000_000, 2, 100_000
_VIRTUAL = re.compile(r"\s*CREATE\s+VIRTUAL", re.IGNORECASE)
_RECOVER = "sqlite3 {} .recover"


class SqliteReader:
    """As `ChunkedReader` is to be used.

    Attributes:
        path: of the file.
        connections: of topics, with the number of their messages.
        warnings: none.
        start_time, end_time: nanoseconds of the first message, and just after the last.
        message_count: of all topics.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.connections: list[Connection] = []
        self.warnings: tuple[str, ...] = ()
        self.start_time, self.end_time, self.message_count = 0, 0, 0

    def __enter__(self) -> Self:
        with open_binary(self.path, BAG, RecordingError) as stream:
            self._size = stream.seek(0, 2)
        if not self._size:
            raise RecordingError("is empty", path=self.path, fix="record again")
        self.allowance = Allowance(self.path, self._size)
        try:
            where = f"{self.path.resolve().as_uri()}?mode=ro&immutable=1"
            # A pass may go on in another thread than the one that began it.
            self._database = sqlite3.connect(where, uri=True, check_same_thread=False)
        except sqlite3.Error as error:
            raise self._refusal(error) from error
        try:
            self._prepare()
            self._check_tables()
            self._read_index()
        except sqlite3.Error as error:
            self._database.close()
            raise self._refusal(error) from error
        except BaseException:
            self._database.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._database.close()

    def messages(
        self, connections: Sequence[Connection], start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Connection, time and bytes of messages from `start` on and before `stop`, in order of time."""
        wanted = {connection.id: connection for connection in connections}
        asked = f"SELECT rowid, topic_id, timestamp FROM messages WHERE topic_id IN ({','.join('?' * len(wanted))})"
        values: list[int] = [*wanted]
        for condition, value in (("timestamp >= ?", start), ("timestamp < ?", stop)):
            if value is not None:
                asked += f" AND {condition}"
                values.append(min(max(value, -(1 << 63)), (1 << 63) - 1))
        try:
            rows = self._rows(f"{asked} ORDER BY timestamp", values)
            for number, (row, topic, time_ns) in enumerate(rows):
                if number >= self.allowance.most_messages:
                    raise self._refusal(f"more messages than {self._size:,} bytes can hold")
                # Sorted rows without data stay small: sqlite keeps them in memory or in a temporary file.
                (data,) = self._database.execute("SELECT data FROM messages WHERE rowid = ?", (row,)).fetchone()
                if not isinstance(time_ns, int) or not isinstance(data, bytes):
                    raise self._refusal("a message whose time is no number, or whose data are no bytes")
                yield wanted[topic], time_ns, data
        except (sqlite3.Error, TypeError) as error:
            raise self._refusal(error) from error

    def _prepare(self) -> None:
        self._database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, min(_LONGEST_VALUE, max(self._size, 1 << 20)))
        self._database.setlimit(sqlite3.SQLITE_LIMIT_ATTACHED, 0)
        self._database.set_progress_handler(self._step, _LOOK_STEPS)
        self._steps_left = 0
        for pragma in ("trusted_schema = OFF", "cell_size_check = ON"):
            self._database.execute(f"PRAGMA {pragma}")

    def _step(self) -> bool:
        """Whether sqlite is to stop."""
        self._steps_left -= _LOOK_STEPS
        return self._steps_left < 0

    def _rows(self, asked: str, values: Sequence[Any] = ()) -> Iterator[Any]:
        self._steps_left = _FREE_STEPS + _STEPS_A_BYTE * self._size
        return self._database.execute(asked, values)

    def _check_tables(self) -> None:
        """Raises RecordingError where a table is missing or no plain one."""
        found: dict[str, str] = {}
        for name, text in self._rows("SELECT name, sql FROM sqlite_master WHERE type = 'table'"):
            found[name] = str(text)
            if len(found) > _MOST_SCHEMA:
                raise self._refusal(f"more than {_MOST_SCHEMA} tables")
        for name in ("messages", "topics", "message_definitions"):
            if name not in found and name != "message_definitions":
                raise self._refusal(f"no table {name}")
            columns = list(self._rows("SELECT hidden FROM pragma_table_xinfo(?)", (name,)))
            if _VIRTUAL.match(found.get(name, "")) or any(hidden for (hidden,) in columns):
                raise self._refusal(f"a table {name} that computes its values")
        self._defines = "message_definitions" in found

    def _read_index(self) -> None:
        counts: dict[Any, int] = {}
        asked = "SELECT topic_id, count(*), min(timestamp), max(timestamp) FROM messages GROUP BY topic_id"
        for topic, count, first_ns, last_ns in self._rows(asked):
            if not isinstance(first_ns, int) or not isinstance(last_ns, int):
                raise self._refusal("messages whose times are no numbers")
            self.start_time = min(self.start_time, first_ns) if counts else first_ns
            self.end_time = max(self.end_time, last_ns + 1) if counts else last_ns + 1
            counts[topic] = count
        definitions: dict[str, tuple[str, str]] = {}
        if self._defines:
            asked = "SELECT topic_type, encoding, substr(encoded_message_definition, 1, ?) FROM message_definitions"
            for type_, language, text in self._rows(f"{asked} LIMIT ?", (LONGEST_DEFINITION + 1, MOST_CONNECTIONS)):
                if language in _LANGUAGES and isinstance(text, str):
                    definitions.setdefault(type_, (_LANGUAGES[language], text))
        for number, name, type_, form in self._rows("SELECT id, name, type, serialization_format FROM topics"):
            if len(self.connections) >= MOST_CONNECTIONS:
                raise self._refusal(f"more than {MOST_CONNECTIONS:,} topics")
            if not (isinstance(number, int) and isinstance(name, str) and isinstance(type_, str)):
                raise self._refusal("a topic without number, name or type")
            if form == "cdr":
                defined = definitions.get(type_, ("NONE", ""))
                self.connections.append(Connection(number, name, type_, *defined, counts.get(number, 0)))
        self.message_count = sum(connection.msgcount for connection in self.connections)

    def _refusal(self, found: str | Exception) -> RecordingError:
        what = (
            f"is no sqlite3 database, or a damaged one: {found}" if isinstance(found, Exception) else f"holds {found}"
        )
        return RecordingError(what, path=self.path, fix=_RECOVER.format(self.path.name))
