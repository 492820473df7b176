"""Where a run is shown: a file, or a viewer that is started on this machine and listens to nobody else's."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from wheelsight.calibration import Calibration
from wheelsight.errors import ConfigError
from wheelsight.extras import needed, why_missing
from wheelsight.files import check_name, output_error
from wheelsight.settings import ViewerSettings
from wheelsight.viewer.blueprint import blueprint_of
from wheelsight.viewer.rerun_log import RerunLog

SPAWN = "spawn"
_APPLICATION = "wheelsight"
_LOOPBACK = "127.0.0.1"
_START_S = 20.0
_VIEWER = (sys.executable, "-m", "rerun")


def why_no_rerun() -> str | None:
    """Why nothing can be shown in Rerun: it is not installed. None where it is."""
    return why_missing("rerun")


@contextmanager
def rerun_log(
    target: str,
    calibration: Calibration,
    tracks: Sequence[str],
    settings: ViewerSettings | None = None,
    viewer: Sequence[str] = _VIEWER,
) -> Iterator[RerunLog]:
    """What a run is shown by, as the `watcher` of `run_each`; all is written once it is closed.

    Args:
        target: a file to write, .rrd; or "spawn": a viewer that is started, and stays when the run is over.
        calibration: of the run.
        tracks: names of what it follows.
        settings: or the defaults.
        viewer: the command that starts Rerun's viewer.

    Raises:
        ConfigError: Rerun is not installed, or its viewer does not start.
        OutputError: the file cannot be written.
    """
    stream = _stream()
    if target == SPAWN:
        stream.connect_grpc(_started(viewer), default_blueprint=blueprint_of(tracks))
    else:
        _save(stream, Path(target), tracks)
    log = RerunLog(stream, calibration, tracks, settings or ViewerSettings())
    try:
        yield log
    finally:
        stream.flush()
        stream.disconnect()


def _stream() -> Any:
    """With one timeline, that of the recording."""
    rerun = needed("rerun")
    stream = rerun.RecordingStream(_APPLICATION)
    stream.set_log_time_enabled(False)
    stream.set_log_tick_enabled(False)
    return stream


def _save(stream: Any, path: Path, tracks: Sequence[str]) -> None:
    check_name(path)
    try:
        with path.open("wb"):
            pass  # Rerun itself says nothing of a file that cannot be written
    except OSError as error:
        raise output_error(error, path) from error
    stream.save(path, default_blueprint=blueprint_of(tracks))


def _started(viewer: Sequence[str]) -> str:
    """The address of a viewer that has just been started, on loopback alone."""
    with socket.socket() as found:
        found.bind((_LOOPBACK, 0))
        port = found.getsockname()[1]
    command = [*viewer, "--bind", _LOOPBACK, "--port", str(port), "--expect-data-soon"]
    try:
        process = subprocess.Popen(command, env=_environment(), start_new_session=True)
    except OSError as error:
        raise ConfigError(f"Rerun's viewer cannot be started: {error}", fix="--rerun FILE.rrd") from error
    deadline_s = time.monotonic() + _START_S
    while time.monotonic() < deadline_s and process.poll() is None:
        with contextlib.suppress(OSError), socket.create_connection((_LOOPBACK, port), timeout=1):
            return f"rerun+http://{_LOOPBACK}:{port}/proxy"
        time.sleep(0.05)
    process.kill()
    raise ConfigError("Rerun's viewer did not start: it needs a screen", fix="--rerun FILE.rrd, and open that later")


def _environment() -> dict[str, str]:
    """In which the viewer tells nobody how it is used; on Linux, where its settings are found by this variable."""
    folder = Path(tempfile.gettempdir()) / f"wheelsight-rerun-{os.getuid() if hasattr(os, 'getuid') else 0}"
    settings = folder / "rerun" / "analytics.json"
    settings.parent.mkdir(parents=True, exist_ok=True)
    settings.write_text(json.dumps({"analytics_enabled": False, "analytics_id": "", "metadata": {}}), encoding="utf-8")
    return {**os.environ, "XDG_CONFIG_HOME": str(folder)}
