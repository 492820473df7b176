"""Images of simulated drives kept on disk, since rendering takes longer than all that is done with them."""

from __future__ import annotations

import heapq
import shutil
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.lib.format import open_memmap

from wheelsight.core.messages import Event, RgbdFrame
from wheelsight_sim import SimulatedRecording


def kept_events(recording: SimulatedRecording, folder: Path) -> Iterator[Event]:
    """The recording's events; images come from a folder named by its settings, where they are rendered at first.

    Nothing shows that the simulator has changed since: then the folder is to be deleted.
    """
    name = sha256(repr(recording.settings).encode()).hexdigest()[:12]
    images = folder / f"{recording.name}-{name}"
    if not images.is_dir():
        _render(recording, images)
    color = np.load(images / "color.npy", mmap_mode="r")
    depth_m = np.load(images / "depth_m.npy", mmap_mode="r")
    stamp_s = recording.renderer.stamp_s
    frames = (RgbdFrame(stamp_s(i), np.array(color[i]), np.array(depth_m[i]), i) for i in range(len(color)))
    return heapq.merge(recording.events(images=False), frames, key=lambda event: event.stamp_s)


def _render(recording: SimulatedRecording, images: Path) -> None:
    """Into a folder that gets its name once all is in it."""
    size = recording.settings.size
    assert size is not None
    shape = (recording.frame_count, size[1], size[0])
    unfinished = images.with_suffix(".unfinished")
    shutil.rmtree(unfinished, ignore_errors=True)
    unfinished.mkdir(parents=True)
    color = open_memmap(unfinished / "color.npy", "w+", np.uint8, (*shape, 3))
    depth_m = open_memmap(unfinished / "depth_m.npy", "w+", np.float32, shape)
    for event in recording.events():
        if isinstance(event, RgbdFrame):
            color[event.index], depth_m[event.index] = event.color, event.depth_m
    color.flush()
    depth_m.flush()
    unfinished.rename(images)
