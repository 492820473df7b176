"""What README and docs tell a newcomer to type works, page by page, from top to bottom in a fresh folder.

A page's names of recordings are given small ones. What is not run stands in NOT_RUN, with its reason.
"""

from __future__ import annotations

import importlib.util
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from area_drive import write_area_drive
from documentation_blocks import USERS_CODE, declared, python_blocks, unmade
from documentation_commands import unknown_in, wheelsight_commands
from drives import simulate as drive_legs
from drives import square_legs, write_recording
from floor_plans import rooms_in_colours, two_rooms, write_plan
from places.made_recording import write_drive
from shared_folders import shared_folder
from sources import BESIDE
from typer.testing import CliRunner
from written_bags import robot_drive, write_bag

from wheelsight.app.cli import app
from wheelsight.core.calibration import Calibration, load_calibration, save_calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.trajectory import read_tum
from wheelsight.io.devices.simulated_controller import SimulatedController
from wheelsight.io.recordings import open_recording
from wheelsight_sim import SimulationSettings, simulate, write_simulation

PROJECT = Path(__file__).resolve().parent.parent
PAGES = ("README.md", "CONTRIBUTING.md", *(f"docs/{path.name}" for path in sorted((PROJECT / "docs").glob("*.md"))))
DOCS = PROJECT / "docs"
DECISIONS = sorted({*(DOCS / "decisions").glob("*.md")} - {DOCS / "decisions" / "index.md"})
# Beginnings of commands, and why they are not run here.
NOT_RUN = {
    "make ": "sets up environments, or needs a chip; continuous integration runs what can be",
    "pip install ": "changes the environment; the Makefile's targets do it",
    "python3 -m venv ": "changes the environment",
    "python -m benchmarks": "takes minutes; tests/benchmarks",
    "python papers/": "needs recordings that are not part of the project; tests/papers",
    "rerun ": "opens a window; tests/viewer reads the files",
    "wheelsight wheels ": "needs a wheel controller; tests/cli/test_wheels.py",
    "wheelsight devices": "shows this machine; tests/cli/test_devices.py",
    "wheelsight calibrate robot robot.yaml --from ": "needs a map; tests/calibration/test_self_calibration.py",
    "wheelsight batch RECORDING": "of whole recordings; docs/batch.md's is of short ones",
    "wheelsight record ": "needs a wheel controller or a camera; tests/cli/test_record.py, test_record_camera.py",
    "wheelsight run --live ": "needs a camera or a wheel controller; tests/cli/test_run_live.py",
    "wheelsight run sample ": "twenty seconds; tests/recordings/test_sample.py",
    "wheelsight run corridor ": "of the recording that the controller made",
    "wheelsight drive ": "needs the map of a building that the simulator has; tests/cli/test_drive.py",
    "wheelsight serve ": "goes on until it is interrupted; tests/cli/test_serve.py",
    "wheelsight urdf ": "of a robot's own files; tests/links/test_urdf.py",
    "wheelsight map info home": "of the map that an exploration leaves after minutes",
    "wheelsight map name ": "names a place of that map; tests/cli/test_maps.py",
    "wheelsight map zone ": "draws in that map; tests/cli/test_map_zones.py",
    "wheelsight map export home ": "of that map; tests/cli/test_maps.py",
    "wheelsight simulate flat --laps 2": "a minute of driving, for that map",
    "wheelsight run monday --map surfels --loops keyframes --out home": "of that drive",
    "wheelsight simulate floor4 --laps 2": "four minutes of driving; docs/simulation.md's is run for some seconds",
    "wheelsight simulate floor4 --realism ideal --rate 5": "drives of whole floors; small ones stand for them",
    "wheelsight map merge ": "needs the maps of two days; tests/cli/test_maps.py",
    "wheelsight map prune both": "of the map that was merged; tests/cli/test_maps.py",
    "for seed in 1 2 3": "six squares, simulated; drawn ones stand for them",
}
# Options put to the end of commands, where the last one wins, so that they take seconds.
_BRIEF = "--duration 6 --rate 4 --size 160x120"
SHORTER = {
    "wheelsight simulate floor4 --out": _BRIEF,
    "wheelsight simulate --plan": _BRIEF,
    # The second day must still be found in the map of the first.
    "wheelsight simulate flat --rate 8 --duration 20": "--duration 10 --rate 5",
    "wheelsight simulate flat --day 1": "--duration 5 --rate 5",
    "wheelsight simulate square --rate 8": "--duration 3 --rate 5",
}
# A page about what one plugs in: its commands are run with stand-ins.
YOURS = "docs/tutorial-your-robot.md"
# In its commands, what stands for what; a controller listens at the pseudo-terminal.
STAND_INS = {"/dev/ttyACM0": "ttyWHEELS", "--camera any": "--camera recording:my_recording"}
# What is endless or long ends so, where the last option wins.
ENDING = {"wheelsight wheels monitor ": "--seconds 1", "wheelsight record ": "--seconds 1"}
# What stand-ins show is no drive: after its recording there is one, of the simulator.
DRIVEN = ("calibration_drive", "loop")
# Beginnings of its commands that are not run even so, and why.
NOT_WITH_STAND_INS = {
    "pip install ": "as above",
    "make ": "as above",
    "wheelsight warm-up": "minutes where nothing is compiled yet; tests/cli/test_warm_up.py",
    "wheelsight wheels simulate ": "the test has its own controller; tests/cli/test_wheels.py",
    "wheelsight run sample ": "twenty seconds; tests/recordings/test_sample.py",
    "wheelsight devices": "shows this machine; tests/cli/test_devices.py",
    "wheelsight calibrate camera --camera any": "a minute of views; tests/cli/test_calibrate_camera.py draws them",
    "wheelsight run calibration_drive --odometry dense": "half a minute; the truth stands for its trajectory",
    "wheelsight calibrate base ": "ten seconds; that of docs/base-calibration.md is run",
    "wheelsight run --live ": "rehearses for half a minute; tests/cli/test_run_live.py",
    "wheelsight map ": "of the map that it leaves; tests/cli/test_maps.py",
    "wheelsight drive ": "needs a map of where the camera is; tests/cli/test_drive.py",
}
# What means something to a shell, which then runs the command.
FOR_A_SHELL = re.compile(r"[*?$|&;<>`\n\\]")
# Only calibrations need all of RECORDING; its first seconds run alike.
SHORT_RUN = ("wheelsight run RECORDING", "wheelsight run my_recording")
LANGUAGES = ("console", "sh")
WHEELS = Wheels(0.17, 0.17, 0.58, 3200)
# Straight ways and turns both ways, on the spot too: (seconds, m/s, rad/s).
LEGS = (
    *((1.0, 0.5, 0.0), (4.0, 0.5, 0.0), (4.0, 0.35, 0.8), (3.0, 0.5, 0.0), (2.0, 0.0, 0.8), (1.0, 0.0, 0.0)),
    *((4.0, 0.35, -0.8), (3.0, 0.6, 0.0), (3.0, 0.0, -0.9), (2.0, 0.4, 0.2), (4.0, 0.4, 0.7), (1.0, 0.0, 0.0)),
    *((3.0, 0.5, -0.3), (4.0, 0.3, -0.8), (3.0, 0.5, 0.0), (3.0, 0.0, 0.8), (3.0, 0.4, 0.0), (4.0, 0.3, -0.7)),
)


def commands_of(text: str) -> Iterator[str]:
    """The commands in a page's blocks: after "$ ", with lines after "> "; or each line, where no prompt is shown."""
    for language, block in re.findall(r"^```(\w+)\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
        if language not in LANGUAGES:
            continue
        lines = block.splitlines()
        if not any(line.startswith("$ ") for line in lines):
            yield from (line for line in lines if line.strip())
            continue
        for line in lines:
            if line.startswith("$ "):
                following = lines[lines.index(line) + 1 :]
                more = [after[2:] for after in following[: _count(following)]]
                yield "\n".join([line[2:], *more])


def _count(lines: list[str]) -> int:
    """How many lines at the start go on with a command."""
    return next((i for i, line in enumerate(lines) if not line.startswith("> ")), len(lines))


def why_not(command: str) -> str | None:
    return next((begin for begin in NOT_RUN if command.removeprefix(".venv/bin/").startswith(begin)), None)


def to_run(page: str) -> list[str]:
    return [one for one in commands_of((PROJECT / page).read_text(encoding="utf-8")) if why_not(one) is None]


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return shared_folder(tmp_path_factory, "documentation", write_recordings)


def write_recordings(folder: Path) -> None:
    """RECORDING, which shows all that is calibrated; `short`, its first seconds; `rooms` and `areas`, whose places
    can be distinguished; and squares."""
    begins = np.cumsum([0.0, *(leg[0] for leg in LEGS)])
    rows = [f"{begin},{v},{w}" for begin, (_, v, w) in zip(begins, (*LEGS, (0.0, 0.0, 0.0)), strict=True)]
    (folder / "legs.csv").write_text("\n".join(["stamp_s,v_m_s,yaw_rate_rad_s", *rows]) + "\n")
    for name, duration_s in (("RECORDING", None), ("short", 6.0)):
        settings = SimulationSettings(
            world="square",
            rate_hz=4,
            size=(320, 240),
            seed=5,
            velocities=folder / "legs.csv",
            duration_s=duration_s,
        )
        write_simulation(simulate(settings), folder / name)
    write_drive(folder / "rooms", with_labels=True)
    write_area_drive(folder / "areas", every_frame=3)
    for number, sense in enumerate((-1, 1, -1, 1)):
        drawn = drive_legs(WHEELS, square_legs(WHEELS, WHEELS, sense))
        write_recording(folder / "squares" / str(number), WHEELS, drawn, drawn.truth.select([0, -1]))


def _link(recording: Path, to: Path) -> None:
    """As a copy, but quicker: what is written over it replaces files, and leaves the others' as they are."""
    shutil.copytree(recording, to, copy_function=os.link)


@pytest.fixture
def fresh(recordings: Path, tmp_path: Path) -> Path:
    """A folder with a recording, or a file, of each name that a page takes for given."""
    for name in ("RECORDING", "path/to/recording"):
        _link(recordings / "RECORDING", tmp_path / name)
    _link(recordings / "short", tmp_path / "my_recording")
    for name in ("drive", "another_drive", "monday", "tuesday", "wednesday"):
        _link(recordings / "areas", tmp_path / name)
    for name in ("my_drive", "other_drive", "third_drive"):
        _link(recordings / "rooms", tmp_path / name)
    shutil.copy(recordings / "three.places", tmp_path / "building.places")
    _link(recordings / "squares", tmp_path / "squares")
    ends_s = read_tum(tmp_path / "my_recording" / "groundtruth_base.txt").stamps_s[[0, -1]]
    match = f"stamp_a_s,stamp_b_s,score\n{ends_s[0]},{ends_s[1]},0.9\n"
    (tmp_path / "my_recording" / "loops.csv").write_text(match)
    (tmp_path / "visual").mkdir()
    shutil.copy(recordings / "RECORDING" / "groundtruth_base.txt", tmp_path / "visual" / "trajectory.txt")
    save_calibration(Calibration(wheels=WHEELS), tmp_path / "nominal.yaml")
    save_calibration(Calibration(wheels=WHEELS), tmp_path / "calibration.yaml")
    rows = ("cw,-0.10,-0.10", "cw,-0.11,-0.09", "ccw,-0.10,0.10", "ccw,-0.09,0.11")
    (tmp_path / "errors.csv").write_text("\n".join(["direction,x_m,y_m", *rows]) + "\n")
    for name in ("my_drive", "other_drive"):
        shutil.copy(recordings / "rooms" / "labels.csv", tmp_path / f"{name}-labels.csv")
    for name in ("map.yaml", "office.yaml"):
        write_plan(tmp_path, two_rooms()).rename(tmp_path / name)
    for name, image in (("flat.png", two_rooms()), ("rooms.png", rooms_in_colours())):
        cv2.imwrite(str(tmp_path / name), image[:-44])  # without the corridor, which is below
    write_bag(tmp_path / "robot.bag", robot_drive())
    for place in ("bin", ".venv/bin"):
        (tmp_path / place).mkdir(parents=True)
        (tmp_path / place / "wheelsight").write_text(f'#!/bin/sh\nexec "{sys.executable}" -m wheelsight "$@"\n')
        (tmp_path / place / "wheelsight").chmod(0o755)
    return tmp_path


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("page", [page for page in PAGES if to_run(page) and page != YOURS])
def test_what_a_page_shows_to_type_works(page: str, fresh: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Most commands in this process, which has loaded by then what each would load again; index.md's in a shell."""
    path = os.pathsep.join([str(fresh / "bin"), os.environ["PATH"]])
    environment = {**os.environ, "PATH": path, "PYTHONPATH": str(PROJECT)}
    monkeypatch.chdir(fresh)
    for command in to_run(page):
        more = next((options for begin, options in SHORTER.items() if command.startswith(begin)), "")
        typed = f"{command.split('  #')[0].replace(*SHORT_RUN)} {more}"
        if typed.startswith("wheelsight ") and not FOR_A_SHELL.search(typed):
            result = CliRunner().invoke(app, shlex.split(typed)[1:])
            code, reported = result.exit_code, f"{result.output}\n{result.exception!r}"
        else:
            answer = subprocess.run(["bash", "-c", typed], env=environment, capture_output=True, text=True, check=False)
            code, reported = answer.returncode, answer.stderr
        assert code == 0, f"{page}: {typed}\n{reported}"


@pytest.mark.slow
def test_the_tutorial_of_ones_own_robot_works_with_stand_ins(
    fresh: Path, recordings: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(fresh)
    reasons = set()
    with SimulatedController(fresh) as controller:
        controller.speeds = (60, 50)
        for command in commands_of((PROJECT / YOURS).read_text(encoding="utf-8")):
            reason = next((begin for begin in NOT_WITH_STAND_INS if command.startswith(begin)), None)
            reasons.add(reason)
            if reason is None:
                type_in(command, recordings)
    assert reasons - {None} == set(NOT_WITH_STAND_INS)
    found = load_calibration("robot.yaml")
    assert found.wheels is not None
    assert found.wheels.track_width_m != 0.52  # a ruler's


def type_in(command: str, recordings: Path) -> None:
    """In this process, which has loaded what takes seconds, or in a shell; stand-ins in place of what is plugged in."""
    typed = command.partition("  #")[0]
    for meant, stand_in in STAND_INS.items():
        typed = typed.replace(meant, stand_in)
    words = shlex.split(f"{typed} {next((end for begin, end in ENDING.items() if typed.startswith(begin)), '')}")
    if words[0] == "wheelsight":
        result = CliRunner().invoke(app, words[1:])
        assert result.exit_code == 0, f"{typed}\n{result.output}"
    else:
        subprocess.run(["bash", "-c", command], check=True)
    for name in DRIVEN:
        if words[:2] == ["wheelsight", "record"] and name in words:
            assert open_recording(name).wheel_count > 10
            assert open_recording(name).frame_count > 1
            shutil.rmtree(name)
            _link(recordings / "RECORDING", Path(name))


def test_every_reason_for_not_running_is_of_some_command() -> None:
    texts = [(PROJECT / page).read_text(encoding="utf-8") for page in PAGES]
    found = {why_not(command) for text in texts for command in commands_of(text)}
    assert found - {None} == set(NOT_RUN)


def test_commands_that_pages_name_have_the_options_that_they_give() -> None:
    """All of them, since those in NOT_RUN and those within text are run by no one."""
    pages = (
        *PAGES,
        "papers/README.md",
        "BENCHMARKS.md",
        *(f"docs/benchmarks/{path.name}" for path in (DOCS / "benchmarks").glob("*.md")),
    )
    reported = [(page, words) for page in pages for words in wheelsight_commands((PROJECT / page).read_text("utf-8"))]
    assert len(reported) > 200
    assert [(page, unknown) for page, words in reported if (unknown := unknown_in(words))] == []
    assert unknown_in(["run", "drive", "--outt", "x", "--map-from=y"]) == ["--outt"]
    assert unknown_in(["map", "shrink", "x"]) == ["shrink"]


def test_the_files_that_the_page_on_architecture_names_are_there() -> None:
    text = (DOCS / "architecture.md").read_text(encoding="utf-8")
    roots = (PROJECT, PROJECT / "wheelsight", *(PROJECT / "wheelsight").glob("*/"))
    named = {name for name in re.findall(r"`([\w/]+(?:\.py|/))`", text) if name.strip("/") not in BESIDE}
    assert len(named) > 20
    assert [name for name in sorted(named) if not any((root / name).exists() for root in roots)] == []


def test_terms_of_the_glossary_are_in_the_files_that_it_names() -> None:
    text = (DOCS / "glossary.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| ([^|]+) \| [^|]+ \| `([\w.]+)`, `([\w/]+\.py)` \|$", text, re.MULTILINE)
    terms = [term.lower() for term, _, _ in rows]
    assert len(rows) == text.count("\n| ") - 1  # all but the head
    assert terms == sorted(set(terms))
    assert len(terms) <= 60
    for term, name, file in rows:
        source = (PROJECT / file).read_text(encoding="utf-8")
        missing = [part for part in name.split(".") if not re.search(rf"\b(class|def) {part}\b", source)]
        assert missing == [], term


def test_new_module_names_can_be_imported() -> None:
    rows = re.findall(r"^\| `([\w.]+)` \| `([\w.]+)` \|$", (DOCS / "old-to-new.md").read_text("utf-8"), re.MULTILINE)
    assert len(rows) > 100
    assert [new for _, new in rows if importlib.util.find_spec(new) is None] == []


def test_pages_beside_the_docs_link_to_files_that_are_there() -> None:
    """Those of docs are held by the site's builder."""
    for page in (*PROJECT.glob("*.md"), PROJECT / "papers" / "README.md"):
        links = re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8"))
        gone = [link for link in links if "://" not in link and not (page.parent / link).exists()]
        assert gone == [], page.name


def test_blocks_are_read_as_a_newcomer_reads_them() -> None:
    page = "```console\n$ one 1   # why\nanswer\n$ for x in 1; do\n>   two\n> done\n```\n"
    page += "```python\nno\n```\n```sh\nthree\n```\n"
    assert list(commands_of(page)) == ["one 1   # why", "for x in 1; do\n  two\ndone", "three"]


def test_what_pages_import_is_there() -> None:
    texts = [path.read_text(encoding="utf-8") for path in (PROJECT / "README.md", *DOCS.rglob("*.md"))]
    blocks = re.findall(r"^```python\n(.*?)^```", "\n".join(texts), re.MULTILINE | re.DOTALL)
    imports = {line for block in blocks for line in block.splitlines() if re.match(r"(from|import) wheelsight", line)}
    assert len(imports) > 10
    for line in sorted(imports):
        exec(line, {})


def typed_blocks() -> dict[str, str]:
    """Each python block of README and docs as a file of its own."""
    pages = (PROJECT / "README.md", *sorted(DOCS.rglob("*.md")))
    return {
        f"{re.sub(r'[^a-z]', '_', path.relative_to(PROJECT).as_posix().lower())}_{line}.py": declared(block)
        for path in pages
        for line, block in python_blocks(path)
    }


def test_what_blocks_take_for_given_is_declared() -> None:
    assert unmade("import a.b as c\nd = [e for e in c.f(g)]\nprint(lambda h: h, d)\n") == ["g"]
    assert declared("print(stamp_s)\n").endswith("stamp_s: float = _given\nprint(stamp_s)\n")
    assert declared("print(events)\n").splitlines()[2:4] == [
        "from wheelsight.core.messages import Event",
        "events: list[Event] = _given",
    ]
    assert len(typed_blocks()) > 30


@pytest.mark.slow
def test_a_strict_checker_takes_what_pages_show(tmp_path: Path) -> None:
    """mypy --strict, without pydantic's plugin, as a user of the package runs it; once for all blocks."""
    for name, text in {**typed_blocks(), "users.py": USERS_CODE}.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    (tmp_path / "mypy.ini").write_text(
        "[mypy]\nstrict = true\nfollow_imports = silent\n[mypy-open3d.*]\nignore_missing_imports = true\n"
    )
    command = [sys.executable, "-m", "mypy", "--config-file", "mypy.ini", "."]
    environment = {**os.environ, "MYPYPATH": str(PROJECT)}
    reported = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert reported.returncode == 0, reported.stdout + reported.stderr


def test_the_site_begins_with_tutorials_and_has_each_page_once() -> None:
    menu = yaml.safe_load((PROJECT / "mkdocs.yml").read_text(encoding="utf-8"))["nav"]
    assert [name for entry in menu[:2] for name in entry] == ["Start", "Tutorials"]
    shown = list(leaves(menu))
    there = {path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md")}
    assert sorted(shown) == sorted(there)
    start = (DOCS / "index.md").read_text(encoding="utf-8")
    assert re.findall(r"^## (.*)$", start, re.MULTILINE)[0] == "Tutorials"


def leaves(menu: object) -> Iterator[str]:
    if isinstance(menu, str):
        yield menu
    for below in menu.values() if isinstance(menu, dict) else menu if isinstance(menu, list) else ():
        yield from leaves(below)


def test_pictures_of_the_first_pages_load_quickly() -> None:
    for page, of_images in ((PROJECT / "README.md", "docs/images"), (DOCS / "index.md", "images")):
        names = re.findall(rf"\]\({of_images}/([\w.-]+)\)", page.read_text(encoding="utf-8"))
        assert len(names) >= 2
        for name in names:
            assert (DOCS / "images" / name).stat().st_size < 150_000, name


@pytest.mark.parametrize("page", DECISIONS, ids=lambda path: path.stem)
def test_a_page_of_decisions_has_its_sections_and_its_line_in_the_index(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    title = re.findall(r"^# (.+)$", text, re.MULTILINE)[0]
    sections = ["Decisions", "Figures", "Tried without success", "Limits"]
    assert re.findall(r"^## (.+)$", text, re.MULTILINE) == sections
    assert len(text.split()) <= 2500
    index = (page.parent / "index.md").read_text(encoding="utf-8")
    assert f"| [{title}]({page.name}) |" in index
