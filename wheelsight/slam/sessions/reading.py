"""What a map folder holds, read from its journals: all but the images, which stay on disk."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from wheelsight.errors import MapError
from wheelsight.geometry import FloatArray
from wheelsight.slam.graph import RelativePose
from wheelsight.slam.sessions import records
from wheelsight.slam.sessions.header import DRIVE
from wheelsight.slam.sessions.journal import Damage, JournalContents, Record, read_journal
from wheelsight.slam.sessions.records import Kind, Place

KEYFRAMES, GRAPH = "keyframes", "graph"
_SUFFIX = ".journal"
# More edges than a thousand hours of driving leave.
_MOST_EDGES = 5_000_000
# Tables are as long as the largest number of a keyframe, which grows by one with each. Half of all keyframes may be
# lost, and of a short map several journals; a number beyond that would ask for memory that no keyframe explains.
_LOST_SHARE, _LOST_KEYFRAMES = 2, 10_000
# Ten digits would be of more journals than a folder has files.
_JOURNAL_NAME = re.compile(r"[0-9]{1,9}")
RUN_AGAIN = "run it again"
_CUT_OFF = "The drive was ended before its map was finished: what it saw last may be missing."
_DAMAGED = "use another copy of the map"


@dataclass(frozen=True, slots=True)
class Health:
    """What is wrong with a map folder, if anything; all else of it is whole.

    Attributes:
        torn_bytes: dropped at the ends of journals: what a kill or a loss of power cut off.
        dropped: keyframes at the end of which not all was written any more.
        damages: bytes between whole records that are no record.
        missing: keyframes that damage took.
        beyond: keyframes that are left out, since their numbers are beyond what the others explain.
        unfinished: what made the map when it was ended, see `MapHeader`; "" where it was finished.
        is_being_made: whether that still makes it.
    """

    torn_bytes: int = 0
    dropped: int = 0
    damages: tuple[Damage, ...] = ()
    missing: tuple[int, ...] = ()
    beyond: tuple[int, ...] = ()
    unfinished: str = ""
    is_being_made: bool = False

    @property
    def is_whole(self) -> bool:
        """Whether nothing but the torn end is wrong."""
        return not self.damages and not self.missing and not self.beyond and not self.incomplete

    @property
    def incomplete(self) -> str:
        """Why a map of less than all keyframes is no map of a drive either; "" where nothing is wrong so."""
        if self.unfinished in ("", DRIVE):
            return ""
        why = f"{self.unfinished} is still making it" if self.is_being_made else f"{self.unfinished} was ended"
        return f"incomplete: {why}"

    @property
    def notes(self) -> tuple[str, ...]:
        """A sentence about each thing that is wrong."""
        told = [f"The map is {self.incomplete}; {RUN_AGAIN}."] if self.incomplete else []
        if self.unfinished == DRIVE:
            told.append("A drive still writes it." if self.is_being_made else _CUT_OFF)
        if self.torn_bytes or self.dropped:
            what = f"{self.torn_bytes:,} bytes and {self.dropped} keyframes at the end"
            told.append(f"The drive was cut off: {what} were not whole and are left out.")
        told += [f"{damage}." for damage in self.damages]
        if self.missing:
            told.append(f"{len(self.missing)} keyframes are lost: {_shown(self.missing)}.")
        if self.beyond:
            told.append(f"Keyframes of impossible numbers are left out: {_shown(self.beyond)}.")
        return tuple(told)


@dataclass(frozen=True, slots=True, eq=False)
class FolderContents:
    """What the journals of a map folder hold.

    Attributes:
        where: journal and record of each keyframe that is whole, by number.
        places: where each keyframe was when it was kept, by number.
        T_map_keyframe: (N, 4, 4) by now; NaN where damage took the pose.
        edges: those that hold.
        edge_count: how many there were, with those withdrawn.
        health: what is wrong.
    """

    where: dict[int, tuple[Path, Record]]
    places: dict[int, Place]
    T_map_keyframe: FloatArray
    edges: tuple[RelativePose, ...]
    edge_count: int
    health: Health


@dataclass
class _Graph:
    """What graph journals tell, record by record."""

    places: dict[int, Place] = field(default_factory=dict)
    T: dict[int, FloatArray] = field(default_factory=dict)
    edges: dict[int, RelativePose] = field(default_factory=dict)
    edge_count: int = 0

    def take(self, record: Record, content: bytes) -> None:
        """Raises MapError for a record that contradicts itself."""
        if record.kind == Kind.PLACE:
            place = records.unpack_place(content)
            self.places[record.key], self.T[record.key] = place, place.T_map_keyframe
        elif record.kind == Kind.EDGES:
            if record.key > _MOST_EDGES:
                raise MapError(f"holds edge {record.key}", fix=_DAMAGED)
            # By the number of the first: damage before it must not shift those that are withdrawn.
            found = records.unpack_edges(content)
            self.edges |= dict(enumerate(found, start=record.key))
            self.edge_count = max(self.edge_count, record.key + len(found))
        elif record.kind == Kind.WITHDRAWN:
            for number in records.unpack_numbers(content):
                self.edges.pop(number, None)
        elif record.kind == Kind.POSES:
            numbers, T = records.unpack_poses(content)
            self.T.update(zip(numbers.tolist(), T, strict=True))


def journal_name(kind: str, number: int) -> str:
    """Such as keyframes-00002.journal."""
    return f"{kind}-{number:05d}{_SUFFIX}"


def journals_of(folder: Path, kind: str) -> list[Path]:
    """The journals of a kind, in the order in which they were written."""
    return [path for _, path in sorted(_numbered(folder, kind))]


def next_number(folder: Path, kind: str) -> int:
    """Of the journal that is written next."""
    return 1 + max((number for number, _ in _numbered(folder, kind)), default=-1)


def _numbered(folder: Path, kind: str) -> Iterator[tuple[int, Path]]:
    """Journals with their numbers; other files may have names that are alike."""
    for path in folder.glob(f"{kind}-*{_SUFFIX}"):
        digits = path.stem.removeprefix(f"{kind}-")
        if _JOURNAL_NAME.fullmatch(digits):
            yield int(digits), path


def read_contents(folder: Path) -> FolderContents:
    """All journals of a folder. Raises MapError for a file that cannot be read, or whose contents are impossible."""
    where: dict[int, tuple[Path, Record]] = {}
    torn_bytes, damages = 0, list[Damage]()
    for journal in _read(folder, KEYFRAMES):
        torn_bytes += journal.torn_bytes
        damages += journal.damages
        found = (record for record, _ in journal.records if record.kind in (Kind.KEYFRAME, Kind.FIRST_KEYFRAME))
        where |= {record.key: (journal.path, record) for record in found}
    graph = _Graph()
    for journal in _read(folder, GRAPH):
        torn_bytes += journal.torn_bytes
        damages += journal.damages
        _take_all(graph, journal)
    known = where.keys() & graph.places.keys()
    end = _LOST_SHARE * len(known) + _LOST_KEYFRAMES
    beyond = tuple(sorted(number for number in known if number >= end))
    count = 1 + max(known.difference(beyond), default=-1)
    missing = tuple(number for number in range(count) if number not in known)
    dropped = sum(number >= count for number in where.keys() | graph.places.keys()) - len(beyond)
    T_map_keyframe = np.full((count, 4, 4), np.nan)
    for number, T in graph.T.items():
        if 0 <= number < count:
            T_map_keyframe[number] = T
    held = {number: where[number] for number in sorted(known) if number < count}
    edges = tuple(edge for _, edge in sorted(graph.edges.items()) if max(edge.first, edge.second) < count)
    health = Health(torn_bytes, dropped, tuple(damages), missing, beyond)
    places = {number: place for number, place in graph.places.items() if number < count}
    return FolderContents(held, places, T_map_keyframe, edges, graph.edge_count, health)


def _shown(numbers: tuple[int, ...]) -> str:
    return ", ".join(map(str, numbers[:5])) + (" and more" if len(numbers) > 5 else "")


def _read(folder: Path, kind: str) -> Iterator[JournalContents]:
    for path in journals_of(folder, kind):
        yield read_journal(path)


def _take_all(graph: _Graph, journal: JournalContents) -> None:
    for record, content in journal.records:
        try:
            graph.take(record, bytes(content))
        except MapError as error:
            problem = f"its record at byte {record.offset:,} {error.problem}"
            raise MapError(problem, path=journal.path, fix=error.fix) from error
