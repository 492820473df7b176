"""Where a run is shown: a file, or a viewer that runs on this machine and accepts only local connections."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from wheelsight.app.viewer.logs import DriveLog, RerunLog, blueprint_of, drive_blueprint
from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import ConfigError
from wheelsight.core.files import check_name, output_error
from wheelsight.core.runtime import needed, why_missing
from wheelsight.core.settings import ViewerSettings

SPAWN = "spawn"
_APPLICATION = "wheelsight"
_LOOPBACK = "127.0.0.1"
_ADDRESS = "rerun+http://"
# A viewer that does not listen by then never will: one on a busy machine of two cores took 2 s.
_START_S = 20.0
VIEWER = (sys.executable, "-m", "rerun")


def why_no_rerun() -> str | None:
    """Why Rerun is unavailable: it is not installed. None if it is."""
    return why_missing("rerun")


def is_file(target: str) -> bool:
    """Whether a target is a file rather than a viewer."""
    return target != SPAWN and not target.startswith(_ADDRESS)


@contextmanager
def open_rerun(
    target: str,
    calibration: Calibration,
    tracks: Sequence[str],
    settings: ViewerSettings | None = None,
    viewer: Sequence[str] = VIEWER,
) -> Iterator[RerunLog]:
    """A log of a run, for `watcher` of `run_each`. Closing it writes everything.

    Args:
        target: a file to write, .rrd; or "spawn": a new viewer, which stays after the run; or the address of a running
            one, rerun+http://….
        calibration: of the run.
        tracks: names of the run's tracks.
        settings: defaults if None.
        viewer: the command of Rerun's viewer.

    Raises:
        ConfigError: Rerun is not installed, or its viewer does not start.
        OutputError: the file cannot be written.
    """
    with _opened(target, lambda: blueprint_of(tracks), viewer) as stream:
        yield RerunLog(stream, calibration, tracks, settings or ViewerSettings())


@contextmanager
def open_drive_log(
    target: str, calibration: Calibration, settings: ViewerSettings | None = None, viewer: Sequence[str] = VIEWER
) -> Iterator[DriveLog]:
    """A log of a drive to goals; arguments and errors as of `open_rerun`."""
    with _opened(target, drive_blueprint, viewer) as stream:
        yield DriveLog(stream, calibration, settings or ViewerSettings())


@contextmanager
def _opened(target: str, blueprint: Callable[[], Any], viewer: Sequence[str]) -> Iterator[Any]:
    """Rerun's stream to a target."""
    # With one timeline, that of the recording
    rerun = needed("rerun")
    stream = rerun.RecordingStream(_APPLICATION)
    stream.set_log_time_enabled(False)
    stream.set_log_tick_enabled(False)
    if target == SPAWN:
        target, _ = start_viewer(viewer)
    if is_file(target):
        path = Path(target)
        layout = blueprint()
        check_name(path)
        try:
            with path.open("wb"):
                pass  # Rerun itself says nothing of a file that cannot be written
        except OSError as error:
            raise output_error(error, path) from error
        stream.save(path, default_blueprint=layout)
    else:
        stream.connect_grpc(target, default_blueprint=blueprint())
    try:
        yield stream
    finally:
        stream.flush()
        stream.disconnect()


def start_viewer(viewer: Sequence[str] = VIEWER) -> tuple[str, subprocess.Popen[bytes]]:
    """Start a viewer on loopback; returns its address and its process. Raises ConfigError."""
    with socket.socket() as found:
        found.bind((_LOOPBACK, 0))
        port = found.getsockname()[1]
    command = [*viewer, "--bind", _LOOPBACK, "--port", str(port), "--expect-data-soon"]
    try:
        # An environment in which the viewer sends no analytics. On Linux this variable is the folder of its settings.
        # The user's own settings stay unchanged; the viewer writes the file itself.
        folder = Path(tempfile.gettempdir()) / f"wheelsight-rerun-{os.getuid() if hasattr(os, 'getuid') else 0}"
        environment = {**os.environ, "XDG_CONFIG_HOME": str(folder)}
        done = subprocess.run([*viewer, "analytics", "disable"], env=environment, capture_output=True, check=False)
        if done.returncode:
            raise ConfigError("Rerun's viewer does not let its analytics be switched off", fix="--rerun FILE.rrd")
        process = subprocess.Popen(command, env=environment, start_new_session=True)
    except OSError as error:
        raise ConfigError(f"Rerun's viewer cannot be started: {error}", fix="--rerun FILE.rrd") from error
    deadline_s = time.monotonic() + _START_S
    while time.monotonic() < deadline_s and process.poll() is None:
        with contextlib.suppress(OSError), socket.create_connection((_LOOPBACK, port), timeout=1):
            return f"{_ADDRESS}{_LOOPBACK}:{port}/proxy", process
        time.sleep(0.05)
    process.kill()
    raise ConfigError("Rerun's viewer did not start: it needs a screen", fix="--rerun FILE.rrd, and open that later")
