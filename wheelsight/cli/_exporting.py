"""What `wheelsight export` is asked for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

_BODIES = ("base", "camera")
# Options that mean something for some ways alone.
_OF_WAYS = {
    "--all": ("--ply", "--mesh"),
    "--voxel": ("--mesh", "--bag", "--format"),
    "--images": ("--bag",),
    "--body": ("--format",),
    "--out": ("--ply", "--mesh", "--format"),
}
_CALLED = {"--ply": "--ply", "--mesh": "meshes", "--bag": "bags", "--format": "--format"}


@dataclass(frozen=True, slots=True)
class Asked:
    """The options, as they were given; see `export`."""

    source: Path
    out: Path | None
    everything: bool
    voxel_m: float | None
    images: str | None
    body: str | None
    force: bool


def check_asked(asked: Asked, way: str) -> None:
    """Raises ConfigError for options that mean nothing with what is written."""
    from wheelsight.errors import ConfigError

    given = {
        "--all": asked.everything,
        "--voxel": asked.voxel_m is not None,
        "--images": asked.images is not None,
        "--body": asked.body is not None,
        "--out": asked.out is not None,
    }
    for option, ways in _OF_WAYS.items():
        if given[option] and way not in ways:
            fix = "name the file behind --bag" if option == "--out" else f"{' or '.join(ways)}, or no {option}"
            raise ConfigError(f"{option} is of {' and '.join(_CALLED[one] for one in ways)} alone", fix=fix)
    if asked.body is not None and asked.body not in _BODIES:
        raise ConfigError(f"--body is {asked.body!r}", fix=f"one of {', '.join(_BODIES)}")
