"""Jobs of a batch: one recording, one configuration and one seed. A digest of all inputs names the job. Holds
Outcome, too.
"""

from __future__ import annotations

import glob
import hashlib
import json
import traceback
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

from wheelsight.app.run import resolved
from wheelsight.app.run.verdict import JOINED
from wheelsight.config import Config, load_config
from wheelsight.core.errors import ConfigError, WheelsightError
from wheelsight.core.files import StrPath
from wheelsight.io.recordings import find_recordings, open_recording
from wheelsight.slam.settings import FROM_KEYFRAMES, FROM_MATCHES, FROM_NOWHERE

DEFAULTS = "defaults"
"""What a batch without a file of settings calls its only configuration."""

# Settings that name files, by section.
_FILES = {
    "recording": ("camera", "calibration"),
    "places": ("model", "areas"),
    "known_map": ("path",),
    "loops": ("source",),
}
_NO_FILES = (FROM_NOWHERE, FROM_MATCHES, FROM_KEYFRAMES)
_SEEDS = 2**32


@dataclass(frozen=True, slots=True)
class Job:
    """The input of one run.

    Attributes:
        id: digest of recording, settings and code.
        recording: absolute path.
        settings: all of them, as of `Config.to_dict`.
        seed: offset to the seeds of the configuration.
        code: of `code_digest`; a worker with other code must not run the job.
        weight: bytes of the recording, for the estimate of the time left.
    """

    id: str
    recording: str
    settings: Mapping[str, Any]
    seed: int
    code: str
    weight: int


@dataclass(frozen=True, slots=True)
class Case:
    """A row of the table: a recording with one configuration.

    Attributes:
        recording: its name, with as much of its path as makes it unique.
        config: name of the configuration.
        odometry: the main track: "joined", else "rectified", else the first one.
        jobs: identifiers, one a seed.
        problem: why there are none, or None.
        chosen: the automatic choice, such as "wheels,dense"; "" if the configuration names the odometry.
    """

    recording: str
    config: str
    odometry: str = ""
    jobs: tuple[str, ...] = ()
    problem: str | None = None
    chosen: str = ""


class BatchPlan(NamedTuple):
    """All rows, and all jobs by their identifier, longest first, so that no long job runs alone at the end."""

    cases: tuple[Case, ...]
    jobs: dict[str, Job]


def plan_of(recordings: Sequence[StrPath], configs: Sequence[StrPath], seeds: int) -> BatchPlan:
    """Open each recording, resolve each configuration for it, and list the jobs.

    A recording that cannot be opened or run becomes a case with a problem.

    Args:
        recordings: as of `named_recordings`.
        configs: files of settings; without any, the defaults.
        seeds: number of seeds a case; one if nothing is random.

    Raises:
        ConfigError: a file of settings is invalid for every recording.
    """
    paths, given = [Path(path) for path in recordings], [Path(path) for path in configs]
    files: tuple[Path | None, ...] = tuple(given) or (None,)
    for file in files:
        # Parallel runs must not change a map.
        config = load_config(file)
        if config.known_map.extend:
            raise ConfigError(
                "known_map.extend: a batch changes no map", path=file, fix="leave it out; or use wheelsight run"
            )
    config_names = [DEFAULTS] if not given else short_names([file.with_suffix("") for file in given])
    cases, jobs = [], dict[str, Job]()
    for path, name in zip(paths, short_names(paths), strict=True):
        digest = cache(partial(digest_of, path))
        for file, config_name in zip(files, config_names, strict=True):
            case = Case(name, config_name)
            try:
                config, made = _jobs(path, file, digest(), seeds)
            except Exception as error:  # one recording must not end the others
                cases.append(replace(case, problem=problem_of(error)))
                continue
            chosen = "" if load_config(file).odometry else ",".join(config.odometry)
            identifiers = tuple(job.id for job in made)
            cases.append(replace(case, odometry=main_track(config), chosen=chosen, jobs=identifiers))
            jobs.update({job.id: job for job in made})
    return BatchPlan(tuple(cases), dict(sorted(jobs.items(), key=lambda item: -item[1].weight)))


def short_names(paths: Sequence[Path]) -> list[str]:
    """The last part of each path; where two have the same, as many parts as make them unique."""
    parts = [path.absolute().parts for path in paths]
    deepest = max((len(one) for one in parts), default=0)
    names = list[str]()
    for own in parts:
        others = [one for one in parts if one != own]
        count = next((n for n in range(1, deepest) if all(one[-n:] != own[-n:] for one in others)), deepest)
        names.append("/".join(own[-count:]))
    return names


def is_random(config: Config) -> bool:
    """Whether a seed changes results: RANSAC of features, and place recognition with its ferns."""
    return "features" in config.odometry or config.loops.source == FROM_KEYFRAMES


def seeded(config: Config, seeds: int) -> Iterator[Config]:
    """The configuration with its own seeds, then with the next ones; only once if nothing is random."""
    for more in range(seeds if is_random(config) else 1):
        features = config.features.model_copy(update={"seed": (config.features.seed + more) % _SEEDS})
        recognition = config.recognition.model_copy(update={"seed": (config.recognition.seed + more) % _SEEDS})
        yield config.model_copy(update={"features": features, "recognition": recognition})


def _jobs(path: Path, file: Path | None, digest: Digest, seeds: int) -> tuple[Config, list[Job]]:
    """The resolved configuration, and a job for each seed. Raises InputError."""
    config = load_config(file)
    recording = open_recording(path, config.recording)
    config = resolved(recording, config)
    # Digests of all files in the settings, with absolute paths: another process may have another working folder
    files, absolute = list[str](), {}
    for section, names in _FILES.items():
        old, changed = getattr(config, section), dict[str, Any]()
        for name in names:
            value = getattr(old, name)
            found = [
                str(Path(one).absolute())
                if isinstance(one, str) and one not in _NO_FILES and Path(one).exists()
                else None
                for one in (value if isinstance(value, tuple) else (value,))
            ]
            files += [digest_of(one).text for one in found if one is not None]
            if isinstance(value, tuple):
                changed[name] = tuple(new or one for new, one in zip(found, value, strict=True))
            else:
                changed[name] = found[0] or value
        absolute[section] = old.model_copy(update=changed)
    jobs, code = list[Job](), code_digest()
    for seed, one in enumerate(seeded(config.model_copy(update=absolute), seeds)):
        settings = one.to_dict()
        shaping = json.dumps([digest.text, settings, files, code], sort_keys=True)
        name = hashlib.sha256(shaping.encode()).hexdigest()[:20]
        jobs.append(Job(name, str(path.absolute()), settings, seed, code, digest.size))
    return config, jobs


def main_track(config: Config) -> str:
    """The track whose figures count: joined sensors, else rectified wheels, else the first odometry."""
    tracks = config.tracks
    return next((track for track in (JOINED, "rectified") if track in tracks), tracks[0])


_ROOT = Path(__file__).resolve().parents[1]
# Files up to this size are read whole to find changes: images and lists are smaller, and a run reads them anyway. Of a
# larger one, such as a bag, its beginning, middle and end are read.
_WHOLE_BYTES, _PIECE_BYTES = 1 << 20, 1 << 16


class Digest(NamedTuple):
    """A digest of files: text that represents their content, and their size in bytes."""

    text: str
    size: int


def named_recordings(names: Sequence[str]) -> tuple[Path, ...]:
    """Recordings by paths, by patterns such as "data/2026-*", or by folders of recordings.

    In the order of the names, each once. A missing path stays, so that it is reported.

    Raises:
        ConfigError: a pattern without matches.
    """
    found: dict[Path, Path] = {}
    for name in names:
        paths = [Path(name)]
        if glob.has_magic(name) and not paths[0].exists():
            paths = sorted(Path(one) for one in glob.glob(name, recursive=True))  # noqa: PTH207 - absolute patterns, too
            if not paths:
                raise ConfigError(f"nothing fits {name}", fix="check the pattern")
        for path in paths:
            for recording in (find_recordings(path) if path.is_dir() else []) or [path]:
                found.setdefault(recording.resolve(), recording)
    return tuple(found.values())


def digest_of(path: StrPath) -> Digest:
    """A digest of a file, or of all files in a folder: relative names, sizes and content.

    Raises:
        OSError: a file cannot be read.
    """
    root, whole, size = Path(path), hashlib.sha256(), 0
    for file in [path for path in sorted(root.rglob("*")) if path.is_file()] if root.is_dir() else [root]:
        about = file.stat()
        size += about.st_size
        name = file.relative_to(root).as_posix() if file != root else ""
        whole.update(f"{name}\0{about.st_size}\0".encode(errors="surrogateescape"))
        if about.st_size <= _WHOLE_BYTES:
            whole.update(hashlib.sha256(file.read_bytes()).digest())
        else:
            whole.update(f"{about.st_mtime_ns}\0".encode())
            with file.open("rb") as stream:
                middle, end = about.st_size // 2 - _PIECE_BYTES // 2, about.st_size - _PIECE_BYTES
                for begin in (0, max(middle, 0), max(end, 0)):
                    stream.seek(begin)
                    whole.update(stream.read(_PIECE_BYTES))
    return Digest(whole.hexdigest(), size)


@cache
def code_digest() -> str:
    """A digest of wheelsight's own modules: outcomes of one version are not used for another."""
    whole = hashlib.sha256()
    for path in sorted(_ROOT.glob("wheelsight*/**/*.py")):
        whole.update(f"{path.relative_to(_ROOT).as_posix()}\0".encode())
        whole.update(path.read_bytes())
    return whole.hexdigest()


@dataclass(frozen=True, slots=True)
class Outcome:
    """The result of one job.

    Attributes:
        job: its identifier.
        problem: the error in one line, or None.
        is_killed: whether its process was killed, so that the recording may not be the cause.
        figures: by their names in `table.FIGURES`; None if unavailable, such as an ATE without ground truth.
        metrics: metrics.json of the run.
        elapsed_s: duration.
    """

    job: str
    problem: str | None = None
    is_killed: bool = False
    figures: Mapping[str, float | None] = field(default_factory=dict)
    metrics: Mapping[str, Any] = field(default_factory=dict)
    elapsed_s: float = 0.0


def problem_of(error: BaseException) -> str:
    """An error in one line: of the input, of the system, or the place of a bug."""
    if isinstance(error, WheelsightError):
        return str(error)
    if isinstance(error, MemoryError):
        return "memory ran out"
    if isinstance(error, OSError):
        where = "" if error.filename is None else f"{error.filename}: "
        return f"{where}{error.strerror or error}"
    last = traceback.extract_tb(error.__traceback__)[-1:]
    where = "".join(f" ({Path(frame.filename).name}:{frame.lineno})" for frame in last)
    return f"a bug: {type(error).__name__}: {' '.join(str(error).split())}{where}"
