"""How long a user waits before anything happens: importing wheelsight, and asking it for help."""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from dataclasses import dataclass

from benchmarks.run import child_environment

_BARE = "pass"
_IMPORT = "import wheelsight"
_HELP = "import sys; sys.argv = ['wheelsight', '--help']; from wheelsight.app.cli import main; main()"


@dataclass(frozen=True, slots=True)
class Startup:
    """Medians over fresh processes, seconds from their start to their end.

    Attributes:
        bare_s: Python alone.
        import_s: Python and `import wheelsight`.
        help_s: `wheelsight --help`, or None where it failed.
    """

    bare_s: float
    import_s: float
    help_s: float | None

    @property
    def import_alone_s(self) -> float:
        """What `import wheelsight` adds to bare Python."""
        return self.import_s - self.bare_s


def measure_startup(repeats: int = 5) -> Startup:
    """Start each program once to warm the disk's cache, then `repeats` times; all in turn, so that load hits all alike.

    Raises subprocess.CalledProcessError when wheelsight cannot be imported.
    """
    bare, imported = [], []
    for _ in range(repeats + 1):
        bare.append(_seconds(_BARE))
        imported.append(_seconds(_IMPORT))
    try:
        helped = statistics.median([_seconds(_HELP) for _ in range(repeats + 1)][1:])
    except subprocess.CalledProcessError:
        helped = None
    return Startup(statistics.median(bare[1:]), statistics.median(imported[1:]), helped)


def _seconds(program: str) -> float:
    begin = time.perf_counter()
    subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, env=child_environment())
    return time.perf_counter() - begin
