"""decide: what follows from evidence, and whether docs/fusion.md shows the table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from wheelsight.core.estimates import DECISIONS, NO_DECISION, PoseDecision, PoseEvidence, PoseFinding, Status, decide

PAGE = Path(__file__).resolve().parents[2] / "docs" / "fusion.md"


def of(*findings: PoseFinding) -> list[PoseEvidence]:
    return [PoseEvidence(finding) for finding in findings]


def test_without_evidence_the_decision_before_stays() -> None:
    before = PoseDecision(Status.LOST, slip=True)
    assert decide([], before) == before
    assert decide([]) == NO_DECISION


def test_the_last_status_counts_and_the_first_reason() -> None:
    decided = decide(of(PoseFinding.TRACKED, PoseFinding.KIDNAPPED, PoseFinding.NOT_LATER))
    assert (decided.status, decided.reason) == (Status.FAILING, DECISIONS[PoseFinding.KIDNAPPED].reason)
    assert decided.doubtful


def test_a_sensor_that_is_wrong_all_along_is_no_slip() -> None:
    found = of(PoseFinding.WHEELS_ALONE, PoseFinding.SLIP, PoseFinding.DEGENERATE, PoseFinding.SENSOR_WRONG)
    assert decide(found[:3]) == PoseDecision(Status.COASTING, slip=True, degenerate=True)
    assert decide(found)[1:4] == (False, True, True)


def test_the_last_covariance_counts() -> None:
    wide, wider = np.eye(6), 2 * np.eye(6)
    first = PoseEvidence(PoseFinding.UNCOMPARED, covariance=wide)
    second = PoseEvidence(PoseFinding.KIDNAPPED, covariance=wider)
    bare = PoseEvidence(PoseFinding.PLACE_KNOWN, covariance_map=wide)
    decided = decide([first, second, bare], PoseDecision(T_odom_body=np.eye(4)))
    assert decided.covariance is wider
    assert decided.covariance_map is wide
    assert decided.T_odom_body is not None


@pytest.mark.parametrize("finding", PoseFinding)
def test_the_page_shows_each_row_of_the_table(finding: PoseFinding) -> None:
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in PAGE.read_text(encoding="utf-8").splitlines()]
    (status, flags, reason), then = next(row[2:] for row in rows if row[:1] == [finding]), DECISIONS[finding]
    assert status.strip("`") == (then.status or "")
    assert ("`slip`" in flags, "no `slip`" in flags) == (then.slip is not None, then.slip is False)
    assert ("degenerate" in flags, "doubtful" in flags) == (then.is_degenerate, then.is_doubtful)
    assert reason.strip("`") == ("" if then.reason is None else then.reason.name)
