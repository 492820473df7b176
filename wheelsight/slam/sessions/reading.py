"""What a map folder holds, read from its journals: all but the images, which stay on disk."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from wheelsight.errors import MapError
from wheelsight.geometry import FloatArray
from wheelsight.slam.graph import RelativePose
from wheelsight.slam.sessions import records
from wheelsight.slam.sessions.journal import Damage, JournalContents, Record, read_journal
from wheelsight.slam.sessions.records import Kind, Place

KEYFRAMES, GRAPH = "keyframes", "graph"
_SUFFIX = ".journal"
# A thousand hours of driving; a number beyond would ask for a table that fits into no memory.
_MOST_NUMBER = 5_000_000
_DAMAGED = "use another copy of the map"


@dataclass(frozen=True, slots=True)
class Health:
    """What is wrong with a map folder, if anything; all else of it is whole.

    Attributes:
        torn_bytes: dropped at the ends of journals: what a kill or a loss of power cut off.
        dropped: keyframes at the end of which not all was written any more.
        damages: bytes between whole records that are no record.
        missing: keyframes that damage took.
    """

    torn_bytes: int = 0
    dropped: int = 0
    damages: tuple[Damage, ...] = ()
    missing: tuple[int, ...] = ()

    @property
    def is_whole(self) -> bool:
        """Whether nothing but the torn end is wrong."""
        return not self.damages and not self.missing

    @property
    def notes(self) -> tuple[str, ...]:
        """A sentence about each thing that is wrong."""
        told = []
        if self.torn_bytes or self.dropped:
            what = f"{self.torn_bytes:,} bytes and {self.dropped} keyframes at the end"
            told.append(f"The drive was cut off: {what} were not whole and are left out.")
        told += [f"{damage}." for damage in self.damages]
        if self.missing:
            shown = ", ".join(map(str, self.missing[:5])) + (" and more" if len(self.missing) > 5 else "")
            told.append(f"{len(self.missing)} keyframes are lost: {shown}.")
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
    edges: list[RelativePose | None] = field(default_factory=list)

    def take(self, record: Record, content: bytes) -> None:
        """Raises MapError for a record that contradicts itself."""
        if record.key > _MOST_NUMBER:
            raise MapError(f"is of number {record.key}", fix=_DAMAGED)
        if record.kind == Kind.PLACE:
            place = records.unpack_place(content)
            self.places[record.key], self.T[record.key] = place, place.T_map_keyframe
        elif record.kind == Kind.EDGES:
            # By the number of the first: damage before it must not shift those that are withdrawn.
            self.edges += [None] * (record.key - len(self.edges))
            self.edges[record.key :] = records.unpack_edges(content)
        elif record.kind == Kind.WITHDRAWN:
            for number in records.unpack_numbers(content):
                if 0 <= number < len(self.edges):
                    self.edges[number] = None
        elif record.kind == Kind.POSES:
            numbers, T = records.unpack_poses(content)
            self.T.update(zip(numbers.tolist(), T, strict=True))


def journal_name(kind: str, number: int) -> str:
    """Such as keyframes-00002.journal."""
    return f"{kind}-{number:05d}{_SUFFIX}"


def journals_of(folder: Path, kind: str) -> list[Path]:
    """The journals of a kind, in the order in which they were written."""
    return sorted(path for path in folder.glob(f"{kind}-*{_SUFFIX}") if path.stem.rpartition("-")[2].isdigit())


def next_number(folder: Path, kind: str) -> int:
    """Of the journal that is written next."""
    return max((int(path.stem.rpartition("-")[2]) + 1 for path in journals_of(folder, kind)), default=0)


def read_contents(folder: Path) -> FolderContents:
    """All journals of a folder. Raises MapError for a file that cannot be read, or whose contents are impossible."""
    where: dict[int, tuple[Path, Record]] = {}
    torn_bytes, damages = 0, list[Damage]()
    for journal in _read(folder, KEYFRAMES):
        torn_bytes += journal.torn_bytes
        damages += journal.damages
        found = (record for record, _ in journal.records if record.kind in (Kind.KEYFRAME, Kind.FIRST_KEYFRAME))
        # Of a number beyond all there is no place either: it is dropped with those at the end.
        where |= {record.key: (journal.path, record) for record in found}
    graph = _Graph()
    for journal in _read(folder, GRAPH):
        torn_bytes += journal.torn_bytes
        damages += journal.damages
        _take_all(graph, journal)
    count = 1 + max(where.keys() & graph.places.keys(), default=-1)
    missing = tuple(number for number in range(count) if number not in where or number not in graph.places)
    dropped = sum(number >= count for number in where.keys() | graph.places.keys())
    T_map_keyframe = np.full((count, 4, 4), np.nan)
    for number, T in graph.T.items():
        if 0 <= number < count:
            T_map_keyframe[number] = T
    held = {number: found for number, found in where.items() if number < count and number not in missing}
    edges = tuple(edge for edge in graph.edges if edge is not None and max(edge.first, edge.second) < count)
    health = Health(torn_bytes, dropped, tuple(damages), missing)
    places = {number: place for number, place in graph.places.items() if number < count}
    return FolderContents(held, places, T_map_keyframe, edges, len(graph.edges), health)


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
