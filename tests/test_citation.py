"""CITATION.cff: what GitHub and Zenodo need is there, and it names the version and the three papers."""

from __future__ import annotations

from pathlib import Path

import yaml

from wheelsight import __version__


def test_it_can_be_cited(project_folder: Path) -> None:
    cited = yaml.safe_load((project_folder / "CITATION.cff").read_text(encoding="utf-8"))
    assert cited["cff-version"] == "1.2.0"
    assert cited["version"] == __version__
    assert cited["license"] == "Apache-2.0"
    assert {"message", "title", "authors", "type"} <= set(cited)
    first = [reference["authors"][0]["family-names"] for reference in cited["references"]]
    assert first[:3] == ["Trinh", "Zhang", "Ligocki"]
    for reference in cited["references"]:
        assert {"type", "title", "authors"} <= set(reference)
        assert reference["type"] == "generic" or {"conference", "year"} <= set(reference)
