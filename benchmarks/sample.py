"""`python -m benchmarks.sample`: the recording that comes with the package, made again by the simulator.

A lap through a flat of four rooms in 38 s, by wheels and a camera as bad as real ones; 4 images a second of 208×156
pixels keep it small. Colour is JPEG, depth is the simulator's own values; truth has 50 poses a second.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2

from wheelsight.core.files import StrPath, write_bytes, write_text
from wheelsight.io.recordings import SAMPLE
from wheelsight_sim import SimulationSettings, simulate, write_simulation

SETTINGS = SimulationSettings("flat", "kinect-v1", (208, 156), rate_hz=4.0, seed=2, speed_m_s=1.0, realism="real")
LARGEST_BYTES = 3_000_000
_JPEG_QUALITY = 88
_TRUTH_EVERY = 4  # of 200 poses a second
# Depth has some 200 values: unfiltered they repeat, which takes 2/3 of the room of the best filter.
_SMALL_PNG = (cv2.IMWRITE_PNG_COMPRESSION, 9, cv2.IMWRITE_PNG_STRATEGY, 0, cv2.IMWRITE_PNG_FILTER)
_NOT_NEEDED = ("plan.png", "gyro.csv", "truth/world.xml")


def write_sample(folder: StrPath, settings: SimulationSettings = SETTINGS) -> int:
    """Make the recording in an empty or new folder; how many bytes its files have. Raises OutputError."""
    folder = Path(folder)
    write_simulation(simulate(settings), folder)
    for name in _NOT_NEEDED:
        (folder / name).unlink(missing_ok=True)
    for path in sorted((folder / "rgb").glob("*.png")):
        write_bytes(path.with_suffix(".jpg"), _encoded(path, ".jpg", (cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY)))
        path.unlink()
    listed = folder / "rgb.txt"
    write_text(listed, listed.read_text(encoding="utf-8").replace(".png", ".jpg"))
    for path in sorted((folder / "depth").glob("*.png")):
        write_bytes(path, _encoded(path, ".png", (*_SMALL_PNG, cv2.IMWRITE_PNG_FILTER_NONE)))
    for name in ("groundtruth.txt", "groundtruth_base.txt"):
        _thin(folder / name)
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def _encoded(path: Path, kind: str, flags: tuple[int, ...]) -> bytes:
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert image is not None, path
    return cv2.imencode(kind, image, flags)[1].tobytes()


def _thin(path: Path) -> None:
    """Keep every fourth pose, and the last."""
    lines = path.read_text(encoding="utf-8").splitlines()
    head, poses = [line for line in lines if line.startswith("#")], [line for line in lines if line[0] != "#"]
    kept = [*poses[:-1:_TRUTH_EVERY], poses[-1]]
    write_text(path, "\n".join([*head, *kept]) + "\n")


def main() -> None:
    """Replace the recording in the package."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=SAMPLE, help="folder to write, replaced (%(default)s)")
    out = parser.parse_args().out
    with TemporaryDirectory(prefix="wheelsight-sample-") as made:
        size = write_sample(Path(made) / "sample")
        if size > LARGEST_BYTES:
            sys.exit(f"error: it has {size} bytes, more than {LARGEST_BYTES} (lower the rate or the size)")
        shutil.rmtree(out, ignore_errors=True)
        shutil.copytree(Path(made) / "sample", out)
    print(f"{out}: {size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
