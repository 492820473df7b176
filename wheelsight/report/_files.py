"""What lies beside the page: links to a run's results, with a word on each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path
from urllib.parse import quote

from wheelsight.report import _html as html

_FILES = {
    "trajectory.txt": "where it went, in TUM's format: stamp, position, quaternion",
    "covariances.csv": "how surely each pose of it is known",
    "odom.txt": "the same way without leaps, as a controller follows it",
    "trajectory_corrected.txt": "likewise, as known at the end, with loops closed",
    "loops_judged.csv": "loops, and whether they were kept",
    "status.csv": "a row a frame: status, reason, matches, time, frames dropped",
    "areas.csv": "the area by each frame",
    "metrics.json": "all key figures",
    "config.yaml": "all settings, to run it again",
    "map.surfels": "the map; wheelsight export makes points or a mesh of it",
    "map.ply": "the map's points, for MeshLab, CloudCompare or Open3D",
    "mesh.ply": "the map as triangles",
    "map": "the map's folder, for wheelsight run --map-from, drive and export, which makes points or a mesh of it",
    "run.rrd": "the run for Rerun's viewer",
    "run.log": "what was said on the way",
}


def section(folder: Path | None, odometries: Sequence[str] = ()) -> str:
    """Links to what is in `folder`, and in those of odometries in it; nothing where nothing is."""
    if folder is None:
        return ""
    rows = [row for place in ("", *odometries) for row in _rows(folder, place)]
    if not rows:
        return ""
    intro = "Beside this page, as long as they lie where the run left them."
    head = "<thead><tr>" + "".join(f'<th scope="col">{name}</th>' for name in ("File", "Size [kB]", "What it is"))
    table = f'<div class="scroll"><table class="files">\n{head}</tr></thead>\n<tbody>\n' + "\n".join(rows)
    return html.section("files", "Files", intro, table + "\n</tbody>\n</table></div>")


def _rows(folder: Path, place: str) -> Iterator[str]:
    for name, sentence in _FILES.items():
        path = folder / place / name
        if path.exists():
            shown = f"{place}/{name}" if place else name
            is_folder = path.is_dir()
            link = f'<a href="{quote(shown)}{"/" if is_folder else ""}">{escape(shown)}{"/" if is_folder else ""}</a>'
            size = sum(part.stat().st_size for part in path.iterdir()) if is_folder else path.stat().st_size
            yield f'<tr><th scope="row">{link}</th><td>{size / 1e3:,.2f}</td><td>{escape(sentence)}</td></tr>'
