"""How fast the serial link decodes, how late a pose is, and what bad lines do to it."""

from __future__ import annotations

import os
import select
import subprocess
import sys
import tempfile
import time
import tty
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Protocol

import numpy as np

from benchmarks.bad_lines import Outcome, decode_damaged, decode_noise
from wheelsight.core.calibration import Calibration, save_calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.geometry import FloatArray
from wheelsight.io.devices import FrameDecoder, LineDecoder
from wheelsight.io.devices.wire_formats import Counts, Message, encode_message

_NOISE_BYTES, _DAMAGED_FRAMES = 10_000_000, 1_000_000
_DECODED_FRAMES, _REPEATS = 200_000, 5
_READ_BYTES = 4096
_LATENCY_FRAMES, _FIRST_FRAMES, _PERIOD_S = 1500, 50, 0.02
_PATIENCE_S = 60.0


class _Decoder(Protocol):
    def feed(self, data: bytes) -> object: ...


@dataclass(frozen=True, slots=True)
class LinkFigures:
    """What was measured.

    Attributes:
        decode_mb_s: bytes of frames decoded in a second, in millions; the median run, reads of 4096 bytes.
        recognised_mb_s: the same with the format recognised on the way, as the link does it.
        latency_ms: (N,) from the write of a frame's last byte to a pseudo-terminal until the pose's line was read.
        noise, damaged: what random bytes, and frames damaged, dropped and repeated, came to.
    """

    decode_mb_s: float
    recognised_mb_s: float
    latency_ms: FloatArray
    noise: Outcome
    damaged: Outcome


def measure_link(
    latencies: int = _LATENCY_FRAMES, noise_bytes: int = _NOISE_BYTES, frames: int = _DAMAGED_FRAMES
) -> LinkFigures:
    """All figures of the link; takes about a minute."""
    return LinkFigures(
        _decode_mb_s(FrameDecoder()),
        _decode_mb_s(_Timed(LineDecoder())),
        measure_latency_ms(latencies),
        decode_noise(noise_bytes),
        decode_damaged(frames),
    )


def measure_latency_ms(frames: int = _LATENCY_FRAMES) -> FloatArray:
    """Latencies (N,) of `wheelsight wheels serve`, in a process of its own, on a pseudo-terminal."""
    with tempfile.TemporaryDirectory() as folder:
        pipe, calibration = Path(folder) / "pipe", Path(folder) / "robot.yaml"
        save_calibration(Calibration(wheels=Wheels(0.17, 0.17, 0.6, 3200.0)), calibration)
        master, slave = os.openpty()
        tty.setraw(slave)
        words = ["wheels", "serve", os.ttyname(slave), "--pipe", str(pipe), "--calibration", str(calibration)]
        program = [sys.executable, "-m", "wheelsight", *words]
        with subprocess.Popen(program, stderr=subprocess.DEVNULL) as daemon:
            try:
                return _latencies_ms(master, pipe, frames)
            finally:
                daemon.terminate()
                os.close(slave)
                os.close(master)


class _Timed:
    """A `LineDecoder` fed as fast as it takes, its time going on as at 50 frames a second."""

    def __init__(self, decoder: LineDecoder) -> None:
        self._decoder = decoder
        self._now_s = 0.0

    def feed(self, data: bytes) -> object:
        self._now_s += _PERIOD_S
        return self._decoder.feed(data, self._now_s)


def _decode_mb_s(decoder: _Decoder) -> float:
    rng = np.random.default_rng(0)
    ways = np.cumsum(rng.integers(-157, 158, (_DECODED_FRAMES, 2)), axis=0).tolist()
    messages: list[Message] = [Counts(n & 0xFF, 20_000 * n % (1 << 32), *way) for n, way in enumerate(ways)]
    line = b"".join(map(encode_message, messages))
    chunks = [line[start : start + _READ_BYTES] for start in range(0, len(line), _READ_BYTES)]
    seconds = []
    for _ in range(_REPEATS):
        started_s = time.perf_counter()
        for chunk in chunks:
            decoder.feed(chunk)
        seconds.append(time.perf_counter() - started_s)
    return 1e-6 * len(line) / float(np.median(seconds))


def _latencies_ms(master: int, pipe: Path, frames: int) -> FloatArray:
    _wait_for(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    latencies_s: list[float] = []
    answers = select.poll()
    answers.register(reader, select.POLLIN)
    next_s = began_s = time.perf_counter()
    try:
        for n in count():
            is_late = time.perf_counter() > began_s + _PATIENCE_S + n * _PERIOD_S
            if is_late or len(latencies_s) >= _FIRST_FRAMES + frames:
                break
            time.sleep(max(0.0, next_s - time.perf_counter()))
            next_s = time.perf_counter() + _PERIOD_S  # never two at once: no wheel makes the pulses of both in no time
            clock_us = int(1e6 * (time.perf_counter() - began_s))
            frame = encode_message(Counts(n & 0xFF, clock_us, 60 * n, 50 * n))
            os.write(master, frame[:-1])
            written_s = time.perf_counter()
            os.write(master, frame[-1:])
            if _read_line(reader, answers, patient=bool(latencies_s)):
                latencies_s.append(time.perf_counter() - written_s)
    finally:
        os.close(reader)
    return 1e3 * np.array(latencies_s[-frames:])


def _read_line(reader: int, answers: select.poll, patient: bool) -> bool:
    """Whether a line came; frames may go by before the daemon listens."""
    if not answers.poll(1e3 * (_PATIENCE_S if patient else _PERIOD_S)):
        return False
    return os.read(reader, _READ_BYTES).endswith(b"\n")


def _wait_for(pipe: Path) -> None:
    ends_s = time.monotonic() + _PATIENCE_S
    while not pipe.exists():
        if time.monotonic() > ends_s:
            raise TimeoutError(f"{pipe} was not made")
        time.sleep(0.01)
