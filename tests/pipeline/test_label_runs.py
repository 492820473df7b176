from __future__ import annotations

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from wheelsight.app.run.verdict import runs


@given(st.lists(st.sampled_from("ab"), max_size=60))
def test_runs_are_whole(labels: list[str]) -> None:
    found = runs(labels)
    assert [label for first, after, label in found for _ in range(after - first)] == labels
    assert all(a[2] != b[2] for a, b in pairwise(found))
