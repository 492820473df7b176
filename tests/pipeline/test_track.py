"""What a run leaves behind when it ends: no thread, and no error that no one heard of."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import pytest
from room_drive import make_room_drive

from wheelsight.app.runs import run
from wheelsight.config import Config, load_config
from wheelsight.core.keyframes import Keyframe
from wheelsight.io.recordings import open_recording

ODOMETRIES = [load_config(overrides={"odometry": name}) for name in ("features", "dense")]
BY_NAME = pytest.mark.parametrize("config", ODOMETRIES, ids=lambda config: config.odometry[0])
THREAD = "wheelsight-keyframes"


@pytest.fixture
def room(tmp_path: Path, real_odometry: None) -> Path:
    make_room_drive(tmp_path / "room")
    return tmp_path / "room"


@BY_NAME
def test_keyframes_are_made_in_a_thread_that_ends_with_the_run(
    config: Config, room: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    makers: list[threading.Thread] = []
    of_images = Keyframe.of_images

    def made(*given: Any) -> Keyframe:
        makers.append(threading.current_thread())
        return of_images(*given)

    monkeypatch.setattr(Keyframe, "of_images", made)
    run(open_recording(room), config, tmp_path / "out")
    assert makers
    assert all(maker.name.startswith(THREAD) and not maker.is_alive() for maker in makers)


@BY_NAME
def test_what_goes_wrong_in_making_a_keyframe_ends_the_run(
    config: Config, room: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(*_: Any) -> Keyframe:
        raise MemoryError("no room for a keyframe")

    monkeypatch.setattr(Keyframe, "of_images", failing)
    with pytest.raises(MemoryError, match="no room for a keyframe"):
        run(open_recording(room), config, tmp_path / "out")
    assert not [thread for thread in threading.enumerate() if thread.name.startswith(THREAD)]
