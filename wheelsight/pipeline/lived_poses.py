"""LivedPoses: the poses of a run as they were answered, of which hardly any stay in memory."""

from __future__ import annotations

import tempfile
import weakref
from collections.abc import Iterator
from typing import BinaryIO

import numpy as np

from wheelsight.estimates import Estimate
from wheelsight.geometry import FloatArray, IntArray, se2, se3
from wheelsight.trajectory import Trajectory

# Stamp, three rows of the pose, covariance, where odom lies: 416 bytes, where an estimate has some 2 kB.
_STAMP, _POSE, _COVARIANCE, _ODOM, _ROW = 0, slice(1, 13), slice(13, 49), slice(49, 52), 52
# 1.6 MB: wheels at 50 Hz fill it in 82 s.
_CHUNK = 4096


class LivedPoses:
    """Keeps the pose and covariance of each estimate, to the last bit; wheels at 50 Hz alone give 180 000 an hour.

    What fills a chunk goes to a temporary file. Where that cannot be written, as on a full disk, it stays in memory.
    """

    def __init__(self) -> None:
        self._rows: FloatArray = np.empty((_CHUNK, _ROW))
        self._filled = self._stored = 0
        self._file: BinaryIO | None = None
        self._has_disk = True
        self._held: list[FloatArray] = []
        self._has_covariances = True

    def __len__(self) -> int:
        return self._stored + sum(map(len, self._held)) + self._filled

    def add(self, estimate: Estimate) -> None:
        """One that has a pose."""
        assert estimate.T_odom_body is not None
        if self._filled == _CHUNK:
            self._put_away(self._rows)
            self._filled = 0
        row, T, C = self._rows[self._filled], estimate.T_filter_body, estimate.filter_covariance
        assert T is not None
        row[_STAMP], row[_POSE] = estimate.stamp_s, np.ravel(T[:3])
        self._has_covariances &= C is not None
        row[_COVARIANCE] = 0.0 if C is None else np.ravel(C)
        row[_ODOM] = se2.to_parts(estimate.T_filter_odom[np.ix_([0, 1, 3], [0, 1, 3])])
        self._filled += 1

    def trajectory(self, body: str, frame: str) -> Trajectory:
        """As the filter has it, in order of time; of several at one stamp the one that was answered last."""
        stamps_s, at = self._in_order()
        T, C = _unmoved(len(stamps_s)), None
        if self._has_covariances and len(stamps_s):
            C = np.empty((len(stamps_s), 6, 6))
        for rows, kept in self._chunks_at(at):
            T[kept, :3] = rows[:, _POSE].reshape(-1, 3, 4)
            if C is not None:
                C[kept] = rows[:, _COVARIANCE].reshape(-1, 6, 6)
        for array in (T, C):
            if array is not None:
                array.setflags(write=False)  # a trajectory copies what might be written to
        return Trajectory(stamps_s, T, C, body=body, frame=frame)

    def odom(self, body: str) -> Trajectory | None:
        """The same in odom, which does not leap; None where the filter's poses have not leapt either."""
        stamps_s, at = self._in_order()
        T, has_leapt = _unmoved(len(stamps_s)), False
        for rows, kept in self._chunks_at(at):
            has_leapt |= bool(rows[:, _ODOM].any())
            T[kept, :3] = rows[:, _POSE].reshape(-1, 3, 4)
            T[kept] = se3.invert(se3.from_plane(*rows[:, _ODOM].T)) @ T[kept]
        T.setflags(write=False)
        return Trajectory(stamps_s, T, body=body, frame="odom") if has_leapt else None

    def _in_order(self) -> tuple[FloatArray, IntArray]:
        """Stamps (N,) in order of time, and of each row as it was answered the place there; -1 where it has none."""
        answered_s = np.concatenate([rows[:, _STAMP].copy() for rows in self._chunks()])
        # Readings are told of late where wheels have a delay, and a frame may have a reading's stamp.
        order = np.argsort(answered_s, kind="stable")
        stamps_s = answered_s[order]
        is_last = np.ones(len(order), bool)
        is_last[:-1] = np.diff(stamps_s) > 0
        at = np.full(len(order), -1)
        at[order[is_last]] = np.arange(np.count_nonzero(is_last))
        return stamps_s[is_last], at

    def _chunks_at(self, at: IntArray) -> Iterator[tuple[FloatArray, IntArray]]:
        """The rows of each chunk that have a place (N,), and these places."""
        end = 0
        for rows in self._chunks():
            begin, end = end, end + len(rows)
            kept = at[begin:end]
            yield rows[kept >= 0], kept[kept >= 0]

    def _put_away(self, rows: FloatArray) -> None:
        try:
            if self._has_disk:
                if self._file is None:
                    self._file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115 - open as long as the run goes
                    weakref.finalize(self, self._file.close)
                self._write(self._file, rows)
                return
        except OSError:
            self._has_disk = False
        self._held.append(rows.copy())

    def _write(self, file: BinaryIO, rows: FloatArray) -> None:
        data = memoryview(rows.tobytes())
        file.seek(self._stored * rows[0].nbytes)  # over what a full disk took but in part
        while data:
            data = data[file.write(data) :]
        self._stored += len(rows)

    def _chunks(self) -> Iterator[FloatArray]:
        """All rows in the order in which they were answered, some at a time: an hour's are 82 MB."""
        for begin in range(0, self._stored, _CHUNK):
            rows = np.empty((min(_CHUNK, self._stored - begin), _ROW))
            self._read(begin, rows)
            yield rows
        yield from self._held
        yield self._rows[: self._filled]

    def _read(self, begin: int, rows: FloatArray) -> None:
        """From the file, from a row on."""
        assert self._file is not None
        self._file.seek(begin * rows[0].nbytes)
        into = rows.data.cast("B")
        while into:
            count = self._file.readinto(into)  # type: ignore[attr-defined]
            if not count:
                raise OSError("a temporary file has lost poses of the run")
            into = into[count:]


def _unmoved(count: int) -> FloatArray:
    T = np.zeros((count, 4, 4))
    T[:] = np.eye(4)
    return T
