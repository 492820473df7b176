"""How much of a core live interfaces take: all topics, images of 640×480 at 15 Hz, and 20 control periods a second.

    PYTHONPATH=.:tests python tests/links/measure_load.py RECORDING

Frames of a recording are sent in real time with the periods of a drive, over Foxglove to a client of all
topics, and over DDS to one of those of RViz. Printed is the processor time of this process alone.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import time
from dataclasses import replace
from itertools import cycle, islice
from pathlib import Path

import numpy as np
from links.bridged import TOKEN
from rehearsed_drive import rehearsed_drive

from wheelsight.app.run.drives import NamedGoal
from wheelsight.core.messages import RgbdFrame, WheelSpeeds
from wheelsight.io.recordings import open_recording
from wheelsight.navigation import Feedback
from wheelsight_ros2 import LinkSettings, open_bridge

SECONDS, PERIOD_S, FRAME_S, DOMAIN = 20.0, 0.05, 1 / 15, 95
_CLIENT = """
import sys
from links.foxglove_client import FoxgloveClient
with FoxgloveClient(sys.argv[1]) as client:
    client.until_reported()
    client.subscribe(*client.channels)
    while True:
        client.read(1.0)
        client.messages.clear()
"""


def main() -> None:
    """Measure without and with peers."""
    recording = open_recording(Path(sys.argv[1]))
    frames = [one for one in islice(recording.events(), 60) if isinstance(one, RgbdFrame)]
    mount = np.array([[0, 0, 1, 0.2], [-1, 0, 0, 0], [0, -1, 0, 0.8], [0, 0, 0, 1.0]])
    calibration = replace(recording.calibration, T_base_camera=mount)
    drive, _, _ = rehearsed_drive()
    periods: list[Feedback] = []
    drive.go_to(NamedGoal.of((-0.7, -0.4), "the middle"), periods.append)
    settings = LinkSettings(foxglove="0", token=TOKEN, ros2="dds", domain=DOMAIN)
    notes: list[str] = []
    how = {"is_simulated": False, "robot_s": time.time, "on_problem": print, "on_note": notes.append}
    with open_bridge(settings, calibration, **how) as bridge:  # type: ignore[arg-type]
        for name, commands in (
            ("no client", []),
            ("a client of Foxglove with all topics", [["-c", _CLIENT, notes[0].removeprefix("Foxglove: ")]]),
            ("and one of DDS", [["-c", _CLIENT, notes[0].removeprefix("Foxglove: ")], [str(PEER), str(DOMAIN)]]),
        ):
            programs = [
                subprocess.Popen([sys.executable, *one], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL)
                for one in commands
            ]
            time.sleep(8.0 if programs else 0.0)
            began_s, used_s = time.monotonic(), time.process_time()
            next_frame_s, images, steps, longest_s = began_s, cycle(frames), cycle(periods), 0.0
            while (now_s := time.monotonic()) < began_s + SECONDS:
                stamp_s = time.time()
                if now_s >= next_frame_s:
                    bridge.on_events([replace(next(images), stamp_s=stamp_s)])
                    next_frame_s += FRAME_S
                bridge.on_events([WheelSpeeds(stamp_s, 1.0, 1.0)])
                bridge.step(replace(next(steps), stamp_s=stamp_s), drive.navigator)
                took_s = time.monotonic() - now_s
                longest_s = max(longest_s, took_s)
                time.sleep(max(PERIOD_S - took_s, 0.0))
            share = (time.process_time() - used_s) / (time.monotonic() - began_s)
            memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            sys.stdout.write(
                f"{name}: {share:.1%} of a core, a period {longest_s * 1e3:.0f} ms at most, {memory:.0f} MB\n"
            )
            sys.stdout.flush()
            for one in programs:
                one.kill()
                one.wait()


PEER = Path(__file__).with_name("dds_peer.py")
if __name__ == "__main__":
    main()
