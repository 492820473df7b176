"""What long_tests.txt names is there: a test that was renamed would be run again by everybody, unseen."""

from __future__ import annotations

from pathlib import Path

PROJECT = Path(__file__).resolve().parent.parent


def test_each_long_test_is_there() -> None:
    lines = (PROJECT / "tests" / "long_tests.txt").read_text(encoding="utf-8").splitlines()
    named = [line.split("[")[0].split("::") for line in lines if not line.startswith("#")]
    assert len(named) > 100
    sources = {path: (PROJECT / path).read_text(encoding="utf-8") for path, *_ in named}
    assert [name for path, *_, name in named if f"def {name}(" not in sources[path]] == []
