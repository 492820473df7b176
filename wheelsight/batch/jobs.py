"""Jobs: one recording, one configuration, one seed; named by a digest of all that shapes the outcome."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from wheelsight.batch.inputs import Digest, code_digest, digest_of
from wheelsight.batch.outcome import problem_of
from wheelsight.batch.settings import BatchSettings
from wheelsight.config import Config, load_config
from wheelsight.errors import ConfigError
from wheelsight.files import StrPath
from wheelsight.pipeline import resolved
from wheelsight.pipeline.joined import JOINED
from wheelsight.recordings import open_recording
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
    """What a process is handed.

    Attributes:
        id: names it; the same recording, settings and code have the same.
        recording: where it lies, absolute.
        settings: all of them, as `Config.to_dict` gives them.
        seed: how far the seeds are from those of the configuration.
        code: of `code_digest`; another wheelsight must not run it.
        weight: how many bytes the recording has, for what is left to do.
    """

    id: str
    recording: str
    settings: Mapping[str, Any]
    seed: int
    code: str
    weight: int


@dataclass(frozen=True, slots=True)
class Case:
    """A row of the table: a recording by one configuration.

    Attributes:
        recording: its name, as much of its path as tells it apart.
        config: the configuration's.
        odometry: whose figures count: "joined" where sensors are, else "rectified", else the first that is named.
        jobs: identities, one a seed.
        problem: why there are none, or None.
        chosen: what is followed where the configuration names nothing, such as "wheels,dense"; else empty.
    """

    recording: str
    config: str
    odometry: str = ""
    jobs: tuple[str, ...] = ()
    problem: str | None = None
    chosen: str = ""


class Plan(NamedTuple):
    """All rows, and all jobs by their identity, the longest first: else one process is left with it at the end."""

    cases: tuple[Case, ...]
    jobs: dict[str, Job]


def plan_of(
    recordings: Sequence[StrPath], configs: Sequence[StrPath], seeds: int, settings: BatchSettings | None = None
) -> Plan:
    """Open each recording, resolve each configuration for it, and name what is to be run.

    A recording that cannot be opened, or not be run by a configuration, is a case with a problem.

    Args:
        recordings: as `named_recordings` gives them.
        configs: files of settings; of none, the defaults.
        seeds: how many a case; where nothing is random, one.
        settings: how files are told apart.

    Raises:
        ConfigError: a file of settings is wrong for any recording.
    """
    paths, given = [Path(path) for path in recordings], [Path(path) for path in configs]
    files: tuple[Path | None, ...] = tuple(given) or (None,)
    for file in files:
        _refuse(load_config(file), file)
    config_names = [DEFAULTS] if not given else short_names([file.with_suffix("") for file in given])
    cases, jobs = [], dict[str, Job]()
    for path, name in zip(paths, short_names(paths), strict=True):
        digest = _told(partial(digest_of, path, settings))
        for file, config_name in zip(files, config_names, strict=True):
            case, made = _case(path, file, Case(name, config_name), digest, seeds)
            cases.append(case)
            jobs.update({job.id: job for job in made})
    return Plan(tuple(cases), dict(sorted(jobs.items(), key=lambda item: -item[1].weight)))


def short_names(paths: Sequence[Path]) -> list[str]:
    """The last part of each path; where two have the same, as many parts as tell them apart."""
    parts = [path.absolute().parts for path in paths]
    deepest = max((len(one) for one in parts), default=0)
    names = list[str]()
    for own in parts:
        others = [one for one in parts if one != own]
        count = next((n for n in range(1, deepest) if all(one[-n:] != own[-n:] for one in others)), deepest)
        names.append("/".join(own[-count:]))
    return names


def is_random(config: Config) -> bool:
    """Whether a seed changes anything: RANSAC of features and of recognised places, and the ferns of these."""
    return "features" in config.odometry or config.loops.source == FROM_KEYFRAMES


def seeded(config: Config, seeds: int) -> Iterator[Config]:
    """The configuration with its own seeds, and with those that follow; only once where nothing is random."""
    for more in range(seeds if is_random(config) else 1):
        features = config.features.model_copy(update={"seed": (config.features.seed + more) % _SEEDS})
        recognition = config.recognition.model_copy(update={"seed": (config.recognition.seed + more) % _SEEDS})
        yield config.model_copy(update={"features": features, "recognition": recognition})


def _refuse(config: Config, file: Path | None) -> None:
    """Raises ConfigError for what many runs must not do at once."""
    if config.known_map.extend:
        raise ConfigError(
            "known_map.extend: a batch changes no map", path=file, fix="leave it out; or use wheelsight run"
        )


class _Problem(NamedTuple):
    """Why there is no answer."""

    text: str


def _case(path: Path, file: Path | None, case: Case, digest: Digest | _Problem, seeds: int) -> tuple[Case, list[Job]]:
    found = digest if isinstance(digest, _Problem) else _told(lambda: _jobs(path, file, digest, seeds))
    if isinstance(found, _Problem):
        return replace(case, problem=found.text), []
    config, jobs = found
    chosen = "" if load_config(file).odometry else ",".join(config.odometry)
    return replace(case, odometry=main_track(config), chosen=chosen, jobs=tuple(job.id for job in jobs)), jobs


def _told(work: Callable[[], _Answer]) -> _Answer | _Problem:
    """What it answers, or why it cannot."""
    try:
        return work()
    except Exception as error:  # one recording must not end the others
        return _Problem(problem_of(error))


def _jobs(path: Path, file: Path | None, digest: Digest, seeds: int) -> tuple[Config, list[Job]]:
    """The configuration for it, and a job a seed. Raises InputError where it cannot be run."""
    config = _resolved(path, file)
    files = _named_files(config)
    return config, [_job(path, one, seed, digest, files) for seed, one in enumerate(seeded(config, seeds))]


def _resolved(path: Path, file: Path | None) -> Config:
    """All settings for one recording, its odometry chosen where no file names one; one thread each."""
    config = load_config(file, {"dense.threads": 1, "surfels.threads": 1})
    recording = open_recording(path, config.recording.open_options())
    return _absolute(resolved(recording, config))


def _absolute(config: Config) -> Config:
    """The same, files by their whole paths: another process may stand elsewhere."""
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


def _named_files(config: Config) -> tuple[str, ...]:
    """Digests of all files that settings name."""
    found = list[str]()
    for section, names in _FILES.items():
        for name in names:
            value = getattr(getattr(config, section), name)
            found += [digest_of(one).text for one in _several(value) if _is_file(one)]
    return tuple(found)


def _several(value: Any) -> Iterable[Any]:
    return value if isinstance(value, tuple) else (value,)


def _job(path: Path, config: Config, seed: int, digest: Digest, files: tuple[str, ...]) -> Job:
    settings, code = config.to_dict(), code_digest()
    shaping = json.dumps([digest.text, settings, files, code], sort_keys=True)
    name = hashlib.sha256(shaping.encode()).hexdigest()[:20]
    return Job(name, str(path.absolute()), settings, seed, code, digest.size)


def main_track(config: Config) -> str:
    """Whose figures count: joined sensors, else wheels that areas rectify, else the odometry that is named first."""
    tracks = config.tracks
    return next((track for track in (JOINED, "rectified") if track in tracks), tracks[0])
