"""LivedPoses: the poses of a run as they were answered, of which hardly any stay in memory."""

from __future__ import annotations

import tempfile
import weakref
from typing import BinaryIO

import numpy as np

from wheelsight.estimates import Estimate
from wheelsight.geometry import FloatArray, se2, se3
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
        rows = self._in_order()
        T = _poses(rows)
        has_covariances = self._has_covariances and bool(len(rows))
        covariances = rows[:, _COVARIANCE].reshape(-1, 6, 6) if has_covariances else None
        return Trajectory(rows[:, _STAMP], T, covariances, body=body, frame=frame)

    def odom(self, body: str) -> Trajectory | None:
        """The same in odom, which does not leap; None where the filter's poses have not leapt either."""
        rows = self._in_order()
        if not rows[:, _ODOM].any():
            return None
        T_filter_odom = se3.from_plane(*rows[:, _ODOM].T)
        return Trajectory(rows[:, _STAMP], se3.invert(T_filter_odom) @ _poses(rows), body=body, frame="odom")

    def _in_order(self) -> FloatArray:
        rows = self._all()
        # Readings are told of late where wheels have a delay, and a frame may have a reading's stamp.
        rows = rows[np.argsort(rows[:, _STAMP], kind="stable")]
        is_last = np.ones(len(rows), bool)
        is_last[:-1] = np.diff(rows[:, _STAMP]) > 0
        return rows[is_last]

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

    def _all(self) -> FloatArray:
        """(N, 52) in the order in which they were answered."""
        stored = np.empty((self._stored, _ROW))
        if self._file is not None and self._stored:
            self._file.seek(0)
            into = stored.data.cast("B")
            while into:
                count = self._file.readinto(into)  # type: ignore[attr-defined]
                if not count:
                    raise OSError("a temporary file has lost poses of the run")
                into = into[count:]
        return np.concatenate([stored, *self._held, self._rows[: self._filled]])


def _poses(rows: FloatArray) -> FloatArray:
    T: FloatArray = np.tile(np.eye(4), (len(rows), 1, 1))
    T[:, :3] = rows[:, _POSE].reshape(-1, 3, 4)
    return T
