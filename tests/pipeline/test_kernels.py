"""Kernels compiled ahead: what is missing is known, and a drive needs none that the rehearsal did not call."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Generator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from wheelsight import open_recording
from wheelsight.app.run import kernels
from wheelsight.app.run.kernels import write_rehearsal
from wheelsight.config import load_config
from wheelsight.core.errors import OutputError
from wheelsight.core.messages import RgbdFrame
from wheelsight_sim import SimulationSettings, WheelFaults, simulate, write_simulation


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache of two kernels, which are marked as compiled."""
    monkeypatch.setattr(kernels, "_caches", lambda module: {tmp_path})
    monkeypatch.setattr(kernels, "_mark", lambda part: tmp_path / f"{part}.json")
    for name in ("a", "b"):
        (tmp_path / f"{name}.nbi").write_bytes(b"")
    kernels.mark_compiled("wheels")
    return tmp_path


def test_only_what_is_missing_is_compiled(cache: Path) -> None:
    assert kernels.missing_parts(("wheels", "dense")) == ("dense",)


def test_kernels_that_have_gone_are_missing(cache: Path) -> None:
    (cache / "a.nbi").unlink()
    assert kernels.missing_parts(("wheels",)) == ("wheels",)


def test_kernels_that_have_changed_are_missing(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernels, "_digest", lambda: "another")
    assert kernels.missing_parts(("wheels",)) == ("wheels",)


def test_a_mark_that_is_none_is_missing(cache: Path) -> None:
    (cache / "wheels.json").write_text("[]")
    assert kernels.missing_parts(("wheels",)) == ("wheels",)


@pytest.mark.parametrize(
    ("settings", "parts"),
    [
        ({"odometry": "wheels"}, ("wheels",)),
        ({"odometry": "dense", "map": "surfels"}, ("dense",)),
        ({"odometry": "wheels,dense"}, ("wheels", "dense", "joined")),
        ({"odometry": "wheels", "places.model": "m"}, ("wheels", "places")),
        ({"odometry": "dense", "loops.source": "keyframes"}, ("dense", "loops")),
    ],
)
def test_a_run_needs_the_parts_of_its_tracks(settings: dict[str, Any], parts: tuple[str, ...]) -> None:
    assert kernels.parts_of(load_config(overrides=settings)) == parts


def test_what_needs_a_library_that_is_missing_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernels, "find_spec", lambda name: None)
    assert kernels.usable_parts() == ("wheels", "features", "dense", "joined", "loops", "places", "navigation")


def compiled(monkeypatch: pytest.MonkeyPatch, kernels_made: int, seconds: float) -> None:
    """The part `wheels`, in so long, as far as the clock says."""

    def compile_part(part: str) -> Generator[int]:
        yield from range(kernels_made + 1)

    monkeypatch.setattr(kernels, "_compile", compile_part)
    clock_s = iter((1000.0, 1000.0 + seconds))
    monkeypatch.setattr(kernels, "time", SimpleNamespace(monotonic=lambda: next(clock_s)))
    kernels.compile_kernels(["wheels"])


def test_times_are_remembered_of_parts_that_were_compiled_as_a_whole(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = kernels.COSTS["wheels"].kernels
    assert kernels.remembered_costs() == {}
    compiled(monkeypatch, whole, 30.0)
    assert kernels.remembered_costs() == {"wheels": (whole, 30.0)}
    compiled(monkeypatch, whole // 2, 3.0)  # half of them were there already
    assert kernels.remembered_costs() == {"wheels": (whole, 30.0)}
    for damaged in ("[]", '{"wheels": [0, 1]}', '{"wheels": 3}', '{"wheels": [6, 1e300]}', "{"):
        (cache / "wheelsight-compile-times.json").write_text(damaged)
        assert kernels.remembered_costs() == {}


def test_every_part_has_a_cost() -> None:
    assert set(kernels.COSTS) == set(kernels.PARTS)


def test_other_parts_are_estimated_by_those_that_this_computer_has_compiled(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shipped = kernels.CompileEstimate(["dense", "mesh"])
    assert (shipped.total_s, shipped.is_measured) == (
        kernels.COSTS["dense"].seconds + kernels.COSTS["mesh"].seconds,
        False,
    )
    compiled(monkeypatch, kernels.COSTS["wheels"].kernels, 3 * kernels.COSTS["wheels"].seconds)
    here = kernels.CompileEstimate(["dense", "mesh"])
    assert here.total_s == pytest.approx(3 * shipped.total_s)
    assert here.is_measured


@pytest.mark.parametrize("slower", [0.5, 1.0, 4.0])
def test_what_is_left_follows_the_rate(cache: Path, slower: float) -> None:
    """Whatever the first estimate was, the time that is left comes near what it takes."""
    parts = ("features", "dense", "navigation")
    estimate, passed_s, before = kernels.CompileEstimate(parts), 0.0, 0
    total_s = slower * estimate.total_s
    off = []
    for part in parts:
        cost = kernels.COSTS[part]
        estimate.update(part, before, passed_s)
        for made in range(1, cost.kernels + 1):
            passed_s += slower * cost.seconds / cost.kernels
            done, of, left_s = estimate.update(part, before + made, passed_s)
            assert (done, of) == (made, cost.kernels)
            off.append(left_s - (total_s - passed_s))
        before += cost.kernels
    assert abs(off[-1]) < 1e-6
    assert max(map(abs, off[len(off) // 2 :])) < 0.1 * total_s


@pytest.mark.slow
def test_what_cannot_be_compiled_is_reported_by_its_last_line() -> None:
    with pytest.raises(OutputError, match=r"kernels could not be compiled: KeyError: 'nothing'"):
        kernels.compile_kernels(["nothing"])


def test_ctrl_c_ends_the_other_process(monkeypatch: pytest.MonkeyPatch) -> None:
    children: list[subprocess.Popen[str]] = []
    popen = subprocess.Popen

    def start(command: list[str], **options: Any) -> subprocess.Popen[str]:
        code = "import time; print('wheels 1', flush=True); time.sleep(600)"  # compiles for a long while
        children.append(popen([sys.executable, "-c", code], **options))
        return children[0]

    def press(part: str, count: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(subprocess, "Popen", start)
    with pytest.raises(KeyboardInterrupt):
        kernels.compile_kernels(["wheels"], press)
    assert children[0].returncode == -9


def test_each_part_is_compiled_in_a_process_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """The compiler gives nothing back: in one process its memory grew to 1.1 GB."""
    asked: list[list[str]] = []
    popen = subprocess.Popen

    def start(command: list[str], **options: Any) -> subprocess.Popen[str]:
        asked.append(command[3:])
        return popen([sys.executable, "-c", f"print('{command[3]} 1'); print('{command[3]} 2')"], **options)

    monkeypatch.setattr(subprocess, "Popen", start)
    reported: list[tuple[str, int]] = []
    kernels.compile_kernels(["wheels", "dense"], lambda part, count: reported.append((part, count)))
    assert asked == [["wheels"], ["dense"]]
    assert reported == [("wheels", 1), ("wheels", 2), ("dense", 3), ("dense", 4)]


def test_the_rehearsal_is_a_drive_in_which_everything_happens(tmp_path: Path) -> None:
    write_rehearsal(tmp_path / "drive", is_registered=True)
    events = list(open_recording(tmp_path / "drive").events())
    frames = [event for event in events if isinstance(event, RgbdFrame)]
    assert len(events) > 600
    seen = [frame for frame in frames if frame.color.any()]
    assert 3 < len(frames) - len(seen) < len(frames) / 3
    assert all(np.ptp(frame.color) > 100 and 0.3 < np.median(frame.depth_m) < 5 for frame in seen)


COUNT = """
import sys
from pathlib import Path
from numba.core.dispatcher import Dispatcher
from wheelsight import load_config, open_recording, run_each
from wheelsight.app.run.kernel_process import _rehearse
from wheelsight.app.run.kernels import write_rehearsal
from wheelsight_sim import SimulationSettings, simulate, write_simulation

def loaded():
    modules = [module for name, module in sys.modules.items() if name.startswith("wheelsight.")]
    found = (kernel for module in modules for kernel in vars(module).values() if isinstance(kernel, Dispatcher))
    return {f"{one.py_func.__module__}.{one.py_func.__name__}{sign}" for one in found for sign in one.overloads}

folder = Path(sys.argv[1])
for name, is_registered in (("one", True), ("two", False)):
    write_rehearsal(folder / name, is_registered=is_registered)
    for part in ("joined", "simulation"):
        _rehearse(part, open_recording(folder / name), folder / "results")
before = loaded()
write_simulation(simulate(SimulationSettings(duration_s=1.0, rate_hz=4, size=(80, 60), seed=3)), folder / "simulated")
for settings in ({"odometry": "wheels,dense", "map": "surfels"}, {"odometry": "wheels,features"}):
    run_each(open_recording(folder / "drive"), load_config(overrides=settings), folder / "out", force=True)
print(*(loaded() - before), sep="\\n")
"""


@pytest.mark.slow
def test_a_drive_with_mishaps_needs_nothing_more(tmp_path: Path) -> None:
    """Covered for three seconds, a wheel lifted for two: no frame of it waits for a compiler."""
    mishaps: dict[str, Any] = {"covered_s": ((3, 6),), "faults": WheelFaults(lifted_s=((8, 10),))}
    settings = SimulationSettings(world="square", size=(320, 240), rate_hz=3, duration_s=12, **mishaps)
    write_simulation(simulate(settings), tmp_path / "drive")
    reported = subprocess.run(
        [sys.executable, "-c", COUNT, str(tmp_path)], capture_output=True, text=True, check=False, timeout=280
    )
    assert reported.returncode == 0, reported.stderr
    assert reported.stdout.strip() == ""


COUNT_DRIVEN = """
import sys
import numpy as np
from numba.core.dispatcher import Dispatcher
from rehearsed_drive import CALIBRATION
from wheelsight.core.estimates import Estimate, Status
from wheelsight.core.geometry import se3
from wheelsight.navigation import GrowingFloor, KnownFloor, Navigator
from wheelsight.app.run.kernel_process import drawn_room, rehearse_navigation
from wheelsight_sim import SimulationSettings
from wheelsight_sim.simulator import Simulator

def loaded():
    modules = [module for name, module in sys.modules.items() if name.startswith("wheelsight.navigation.")]
    found = (kernel for module in modules for kernel in vars(module).values() if isinstance(kernel, Dispatcher))
    return {f"{one.py_func.__module__}.{one.py_func.__name__}{sign}" for one in found for sign in one.overloads}

class Truth:
    keyframes = recognised = None
    def __init__(self, robot):
        self.robot, self.T_map_world = robot, np.linalg.inv(robot.T_world_base)
    def process(self, events):
        T = se3.nearest(self.T_map_world @ self.robot.T_world_base)
        return [(event, Estimate(event.stamp_s, Status.TRACKING, T, 1e-6 * np.eye(6), body="base")) for event in events]
    def close(self):
        pass

rehearse_navigation(CALIBRATION)
before = loaded()
robot = Simulator(SimulationSettings("flat", size=(160, 120), rate_hz=10, seed=3, realism="real"))
navigator = Navigator(robot, Truth(robot), KnownFloor(drawn_room()), trusts_floor=True)
navigator.go_to_pose((1.0, 0.3, 0.5))
for _ in range(80):
    navigator.step()
growing = GrowingFloor(Truth(robot), robot.calibration, navigator.footprint, trusted_m=1.5)
growing.update(np.zeros(3), 0.0)
assert loaded(), "kernels are compiled"
print(*(loaded() - before), sep="\\n")
"""


@pytest.mark.slow
def test_a_drive_to_a_goal_needs_nothing_more(project_folder: Path) -> None:
    """The first command of the first drive does not wait for a compiler."""
    path = f"{project_folder}:{project_folder / 'tests'}"
    reported = subprocess.run(
        [sys.executable, "-c", COUNT_DRIVEN],
        capture_output=True,
        text=True,
        check=False,
        timeout=280,
        env={**os.environ, "PYTHONPATH": path},
    )
    assert reported.returncode == 0, reported.stderr
    assert reported.stdout.strip() == ""
