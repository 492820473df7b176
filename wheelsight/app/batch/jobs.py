"""Jobs of a batch: one recording, one configuration and one seed. A digest of all inputs names the job. Holds the
settings of a batch and Outcome, too.
"""

from __future__ import annotations

import glob
import hashlib
import json
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from wheelsight.app.run import resolved
from wheelsight.app.run.verdict import JOINED
from wheelsight.config import Config, load_config
from wheelsight.core.errors import ConfigError, WheelsightError
from wheelsight.core.files import StrPath
from wheelsight.core.settings import CHOSEN, Settings, setting
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
_Answer = TypeVar("_Answer")


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


def plan_of(
    recordings: Sequence[StrPath], configs: Sequence[StrPath], seeds: int, settings: BatchSettings | None = None
) -> BatchPlan:
    """Open each recording, resolve each configuration for it, and list the jobs.

    A recording that cannot be opened or run becomes a case with a problem.

    Args:
        recordings: as of `named_recordings`.
        configs: files of settings; without any, the defaults.
        seeds: number of seeds a case; one if nothing is random.
        settings: how changed files are found.

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
        digest = _answer_of(partial(digest_of, path, settings))
        for file, config_name in zip(files, config_names, strict=True):
            case, made = _case(path, file, Case(name, config_name), digest, seeds)
            cases.append(case)
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


class _JobProblem(NamedTuple):
    """The reason for a missing answer."""

    text: str


def _case(
    path: Path, file: Path | None, case: Case, digest: Digest | _JobProblem, seeds: int
) -> tuple[Case, list[Job]]:
    found = digest if isinstance(digest, _JobProblem) else _answer_of(lambda: _jobs(path, file, digest, seeds))
    if isinstance(found, _JobProblem):
        return replace(case, problem=found.text), []
    config, jobs = found
    chosen = "" if load_config(file).odometry else ",".join(config.odometry)
    return replace(case, odometry=main_track(config), chosen=chosen, jobs=tuple(job.id for job in jobs)), jobs


def _answer_of(work: Callable[[], _Answer]) -> _Answer | _JobProblem:
    """The answer, or the problem of an error."""
    try:
        return work()
    except Exception as error:  # one recording must not end the others
        return _JobProblem(problem_of(error))


def _jobs(path: Path, file: Path | None, digest: Digest, seeds: int) -> tuple[Config, list[Job]]:
    """The resolved configuration, and a job for each seed. Raises InputError."""
    config = load_config(file, {"dense.threads": 1, "surfels.threads": 1})
    recording = open_recording(path, config.recording)
    config = _absolute(resolved(recording, config))
    # Digests of all files in the settings
    found = list[str]()
    for section, names in _FILES.items():
        for name in names:
            value = getattr(getattr(config, section), name)
            found += [digest_of(one).text for one in (value if isinstance(value, tuple) else (value,)) if _is_file(one)]
    files = tuple(found)
    return config, [_job(path, one, seed, digest, files) for seed, one in enumerate(seeded(config, seeds))]


def _absolute(config: Config) -> Config:
    """The configuration with absolute paths, since another process may have another working folder."""
    changed = {}
    for section, names in _FILES.items():
        old = getattr(config, section)
        values = {name: _whole(getattr(old, name)) for name in names}
        changed[section] = old.model_copy(update=values)
    return config.model_copy(update=changed)


def _whole(value: Any) -> Any:
    if isinstance(value, tuple):
        return tuple(_whole(one) for one in value)
    return str(Path(value).absolute()) if _is_file(value) else value


def _is_file(value: Any) -> bool:
    return isinstance(value, str) and value not in _NO_FILES and Path(value).exists()


def _job(path: Path, config: Config, seed: int, digest: Digest, files: tuple[str, ...]) -> Job:
    settings, code = config.to_dict(), code_digest()
    shaping = json.dumps([digest.text, settings, files, code], sort_keys=True)
    name = hashlib.sha256(shaping.encode()).hexdigest()[:20]
    return Job(name, str(path.absolute()), settings, seed, code, digest.size)


def main_track(config: Config) -> str:
    """The track whose figures count: joined sensors, else rectified wheels, else the first odometry."""
    tracks = config.tracks
    return next((track for track in (JOINED, "rectified") if track in tracks), tracks[0])


# Settings


class BatchSettings(Settings):
    """How changed recordings are found, and when a figure is worse than before.

    Of a batch, not of a run: nothing here changes what a run finds, so it is no part of `Config`.
    """

    whole_bytes: int = setting(
        1 << 20,
        "files up to so many bytes are read whole to tell whether they changed: images and lists are smaller, and a "
        "run reads them anyway",
        CHOSEN,
        ge=1,
        le=1 << 40,
    )
    piece_bytes: int = setting(
        1 << 16,
        "of a larger one, such as a bag, its beginning, middle and end of so many bytes are, with its size and when it "
        "was written",
        CHOSEN,
        ge=1,
        le=1 << 30,
    )
    tries: int = setting(
        2,
        "a job whose process was killed is run so many times in all: memory may have been short by chance",
        CHOSEN,
        ge=1,
        le=10,
    )
    tolerance: float = setting(
        0.1, "share by which a figure may be worse than the baseline's", "asked for by issue 34", ge=0, le=100
    )
    least_error: float = setting(
        1e-4,
        "an error that grew by less is not worse, metres or degrees: two versions of a library differ so",
        CHOSEN,
        ge=0,
        le=1,
    )
    least_share: float = setting(
        0.005, "likewise, of the share of frames with a pose: a frame or two of a short recording", CHOSEN, ge=0, le=1
    )
    connect_s: float = setting(10.0, "how long a scheduler may take to answer, seconds", CHOSEN, gt=0, le=3600)


# Recordings and their digests


_ROOT = Path(__file__).resolve().parents[3]


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


def digest_of(path: StrPath, settings: BatchSettings | None = None) -> Digest:
    """A digest of a file, or of all files in a folder: relative names, sizes and content.

    Raises:
        OSError: a file cannot be read.
    """
    root, limits = Path(path), settings or BatchSettings()
    whole, size = hashlib.sha256(), 0
    for file in [path for path in sorted(root.rglob("*")) if path.is_file()] if root.is_dir() else [root]:
        about = file.stat()
        size += about.st_size
        name = file.relative_to(root).as_posix() if file != root else ""
        whole.update(f"{name}\0{about.st_size}\0".encode(errors="surrogateescape"))
        if about.st_size <= limits.whole_bytes:
            whole.update(hashlib.sha256(file.read_bytes()).digest())
        else:
            whole.update(f"{about.st_mtime_ns}\0".encode())
            for piece in _pieces(file, about.st_size, limits.piece_bytes):
                whole.update(piece)
    return Digest(whole.hexdigest(), size)


def _pieces(file: Path, size: int, length: int) -> Iterator[bytes]:
    with file.open("rb") as stream:
        for begin in (0, max(size // 2 - length // 2, 0), max(size - length, 0)):
            stream.seek(begin)
            yield stream.read(length)


@cache
def code_digest() -> str:
    """A digest of wheelsight's own modules: outcomes of one version are not used for another."""
    whole = hashlib.sha256()
    for path in sorted(
        path for package in ("wheelsight", "wheelsight_sim") for path in (_ROOT / package).rglob("*.py")
    ):
        whole.update(f"{path.relative_to(_ROOT).as_posix()}\0".encode())
        whole.update(path.read_bytes())
    return whole.hexdigest()


# Outcomes


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
