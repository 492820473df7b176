"""Each kind of evidence with its tone, its words and what to do; and that worse evidence never sounds better."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from joined_example import joined_run, joined_runs
from narrowing import not_none
from run_example import START_S, empty_run, example_run, wheel_run

from wheelsight.app.run import (
    Evidence,
    Finding,
    FrameDrops,
    FrameRecord,
    RealTimeRecord,
    RunRecord,
    RunVerdict,
    Tone,
    evidence_of,
    judge,
    verdict_of,
    verdict_of_run,
)
from wheelsight.app.run.run_record import KnownMapRecord
from wheelsight.app.run.track import DEPTH_MISPLACED
from wheelsight.app.run.verdict import notes
from wheelsight.core.estimates import Reason, Status
from wheelsight.core.messages import NOTHING_MEASURED
from wheelsight.io.recordings import AssociationReport

JOINED = Evidence(is_joined=True, frames=100, posed=100, slip=0.0, doubtful=0.0, degenerate=0.0)
GREEN, AMBER, RED = Tone.GREEN, Tone.AMBER, Tone.RED
BADNESS = list(Tone)
RECOGNISED = KnownMapRecord("monday", 0.4, 1.2, -0.3, 0.0, 1.5, 0.02, 0.01, views=5, keyframes=9, keyframes_placed=9)


def frames_of(count: int, **others: Any) -> RunRecord:
    """So many frames that were tracked, and nothing else."""
    frames = tuple(FrameRecord(i, 10.0 + i, Status.TRACKING, None, 100, 90, 0.01) for i in range(count))
    whole = AssociationReport(count, count, count, 0.02)
    return replace(replace(empty_run(), frames=frames, association=whole), **others)


def about(verdict: RunVerdict, name: str) -> Finding:
    return next(found for found in verdict.findings if found.about == name)


@pytest.mark.parametrize(
    ("others", "name", "tone", "said", "remedy"),
    [
        ({"posed": 94}, "poses", AMBER, "94 of 100 frames (94 %) have a pose", "status.csv"),
        ({"posed": 20}, "poses", RED, "20 of 100 frames (20 %)", "status.csv"),
        ({"posed": 0}, "poses", RED, "0 of 100 frames (0 %)", "status.csv"),
        ({"lost_episodes": 2, "lost_s": 1.5}, "poses", AMBER, "lost 2 times, for 1.50 s in all", "status.csv"),
        ({"slip": 0.33}, "slip", RED, "slip in 33 % of the time", "calibrate"),
        ({"slip": 0.15}, "slip", AMBER, "slip in 15 % of the time", "drive slowly over it"),
        ({"doubtful": 0.5}, "doubtful", RED, "contradicted each other in 50 % of the time", "calibrate base"),
        ({"degenerate": 0.9}, "degenerate", AMBER, "all directions of motion in 90 %", "more than one wall"),
        (
            {"coasting": 0.6, "coasting_s": (4.0, 2.0)},
            "coasting",
            RED,
            "2 times, for 6.00 s in all (60 %",
            "status.csv",
        ),
        ({"refused": 0.998, "refused_why": Reason.COUNTER_AMBIGUOUS}, "wheels", AMBER, "99.8 %", "max_speed_m_s"),
        ({"beyond_3_sigma": 0.12}, "3σ", AMBER, "within its stated 3σ in 88 % of the time", "calibrate"),
        ({"beyond_3_sigma": 0.88}, "3σ", RED, "within its stated 3σ in 12 % of the time", "calibrate"),
        ({"off_m": 0.7, "way_m": 3.9}, "error", RED, "70.0 cm, 17.9 % of the way", "calibrate"),
        ({"off_m": 0.05, "way_m": 0.3, "slip": None}, "error", AMBER, "16.7 % of the way", "calibrate"),
        ({"off_m": 0.06, "alone": ("dense", 0.04)}, "joining", AMBER, "1.5 times that of dense alone", "calibrate"),
        ({"areas_left": 1.2}, "areas", AMBER, "120 % of the wheels' error", "places train"),
        ({"loops": (3, 1, False)}, "loops", AMBER, "its place was not recognised again", "drive back"),
        ({"loops": (0, 0, True), "length_m": 60.0}, "loops", AMBER, "nothing corrects the drift", "drive back"),
        ({"loops": (2, 7, True)}, "loops", AMBER, "2 loops kept, 7 refused", "plan of the loops"),
        ({"drops": FrameDrops(36, unpaired=25)}, "drops", RED, "25 of 36 frames dropped (69.4 %)", "wheelsight info"),
        ({"drops": FrameDrops(600, overtaken=474)}, "drops", RED, "474 of 600", "lower the camera's rate"),
        ({"drops": FrameDrops(600, overtaken=90, undecoded=80)}, "drops", AMBER, "90 of 600", "disk or decoding"),
        ({"drops": FrameDrops(100, unreadable=5)}, "drops", AMBER, "5 unreadable", "copy the recording again"),
        (
            {"known_map": KnownMapRecord("monday", keyframes=9)},
            "map",
            RED,
            "not recognised in the map monday",
            "--start",
        ),
        ({"known_map": replace(RECOGNISED, keyframes_placed=4)}, "map", AMBER, "where 5 of 9 keyframes lie", "slowly"),
        ({"known_map": replace(RECOGNISED, sigma_m=3.0)}, "map", RED, "1σ 3.00 m", "--start"),
        (
            {"faults": ("The depth is 0.2 times the true one: check it.",)},
            "sensors",
            AMBER,
            "0.2 times",
            "correct what",
        ),
    ],
)
def test_what_is_wrong_has_a_tone_its_numbers_and_what_to_do(
    others: dict[str, Any], name: str, tone: Tone, said: str, remedy: str
) -> None:
    verdict = judge(replace(JOINED, **others))
    found = about(verdict, name)
    assert (verdict.tone, found.tone) == (tone, tone)
    assert said in found.sentence
    assert remedy in found.remedy
    assert found.line == f"{found.sentence} To do: {found.remedy}."
    assert verdict.phrase.startswith("Use with care: " if tone is AMBER else "Do not rely on it: ")


@pytest.mark.parametrize(
    "others",
    [
        {},
        {"posed": 96},
        {"slip": 0.067, "doubtful": 0.019, "coasting": 0.1, "coasting_s": (1.6,)},
        {"beyond_3_sigma": 0.003, "off_m": 0.018, "way_m": 0.1},
        {"off_m": 0.004, "way_m": 3.9, "alone": ("dense", 0.002)},
        {"drops": FrameDrops(600, overtaken=30)},
        {"drops": FrameDrops(600, unpaired=10)},
        {"loops": (9, 3, True), "length_m": 60.0},
        {"loops": (0, 0, True), "length_m": 2.0},
        {"known_map": RECOGNISED},
    ],
)
def test_what_good_runs_have_is_green_and_asks_for_nothing(others: dict[str, Any]) -> None:
    verdict = judge(replace(JOINED, **others))
    assert verdict.tone is GREEN, verdict.concerns
    assert not verdict.concerns
    assert not any(found.remedy for found in verdict.findings)


# A value of each figure and one that is worse or as bad.
share = st.floats(0, 1)
WORSE: dict[str, st.SearchStrategy[tuple[Any, Any]]] = {
    "posed": st.tuples(st.integers(0, 100), st.integers(0, 100)).map(lambda two: (max(two), min(two))),
    **{
        name: st.tuples(share, share).map(lambda two: (min(two), max(two)))
        for name in ("slip", "doubtful", "degenerate", "coasting", "refused", "beyond_3_sigma")
    },
    "lost_episodes": st.tuples(st.integers(0, 3), st.integers(0, 3)).map(lambda two: (min(two), max(two))),
    "off_m": st.tuples(st.floats(0, 9), st.floats(0, 9)).map(lambda two: (min(two), max(two))),
    "areas_left": st.tuples(st.floats(0, 2), st.floats(0, 2)).map(lambda two: (min(two), max(two))),
    "drops": st.tuples(*[st.integers(0, 100)] * 4).map(
        lambda n: (FrameDrops(400, n[0], n[1], n[2], 0), FrameDrops(400, n[0] + n[3], n[1], n[2], 0))
    ),
    "faults": st.sampled_from([((), ("It is wrong: so.",)), (("It is wrong: so.",), ("It is wrong: so.",) * 2)]),
    "known_map": st.sampled_from(
        [
            (None, RECOGNISED),
            (RECOGNISED, replace(RECOGNISED, keyframes_placed=1)),
            (RECOGNISED, replace(RECOGNISED, sigma_m=0.9)),
            (replace(RECOGNISED, sigma_m=0.9), replace(RECOGNISED, sigma_m=9.0)),
            (replace(RECOGNISED, keyframes_placed=1), KnownMapRecord("monday", keyframes=9)),
            (KnownMapRecord("monday", has_start=True), KnownMapRecord("monday")),
        ]
    ),
    "loops": st.sampled_from(
        [
            (None, (5, 0, True)),
            ((5, 0, True), (5, 9, True)),
            ((5, 9, True), (0, 9, True)),
            ((5, 0, True), (5, 0, False)),
        ]
    ),
}


@given(st.fixed_dictionaries(WORSE), st.sets(st.sampled_from(sorted(WORSE)), min_size=1), st.booleans())
def test_worse_evidence_never_has_a_better_tone(
    pairs: dict[str, tuple[Any, Any]], worse: set[str], is_drift_long: bool
) -> None:
    fixed = replace(JOINED, way_m=5.0, alone=("dense", 0.3), coasting_s=(1.0,), length_m=90.0 if is_drift_long else 1.0)
    before = judge(replace(fixed, **{name: pair[0] for name, pair in pairs.items()}))
    after = judge(replace(fixed, **{name: pair[name in worse] for name, pair in pairs.items()}))
    assert BADNESS.index(after.tone) >= BADNESS.index(before.tone)
    for found in after.findings:
        assert (found.tone is GREEN) == (not found.remedy)
    assert after.tone is max((found.tone for found in after.findings), key=BADNESS.index)


def test_the_chief_reason_of_missing_motions_decides_what_to_do() -> None:
    dark = replace(JOINED, posed=30, failures=((Reason.TOO_LITTLE_DEPTH, "no depth: the camera is covered", 70),))
    assert "uncover the camera" in about(judge(dark), "poses").remedy
    covered = replace(JOINED, posed=30, failures=((Reason.FRAME_UNUSABLE, NOTHING_MEASURED, 70),))
    assert "uncover the camera" in about(judge(covered), "poses").remedy
    bent = replace(JOINED, posed=30, failures=((Reason.TOO_LITTLE_DEPTH, DEPTH_MISPLACED, 70),))
    found = about(judge(bent), "poses")
    assert "calibrate camera" in found.remedy
    assert f"{DEPTH_MISPLACED} (70)" in found.sentence


def test_a_fault_of_a_sensor_is_named_before_what_comes_of_it() -> None:
    fault = "Wheels and camera contradict each other all along, and the fault is the camera's: check depth_factor."
    verdict = judge(replace(JOINED, coasting=1.0, coasting_s=(10.0,), faults=(fault,)))
    assert verdict.tone is RED
    assert verdict.phrase == (
        "Do not rely on it: wheels and camera contradict each other all along, and the fault is the camera's"
    )
    assert "the warning about the sensors" in about(verdict, "coasting").remedy


def test_a_fault_of_a_topic_is_named_whole() -> None:
    fault = "/odom: 5.25 of 5.25 m go sideways, which two wheels cannot show; the way is wrong by as much."
    verdict = verdict_of(replace(wheel_run(), faults=(fault,)))
    assert verdict.phrase == "Use with care: /odom: 5.25 of 5.25 m go sideways, which two wheels cannot show"
    assert verdict.concerns[0].line == f"{fault} To do: correct what this names, and run again."


def test_frames_are_judged_by_how_many_have_a_pose() -> None:
    assert verdict_of(example_run(500)).phrase == "Use with care: it was lost once"
    assert verdict_of(empty_run()).phrase == "Do not rely on it: no pose was found"
    assert "too few keypoints with depth (30)" in about(verdict_of(empty_run()), "poses").sentence
    assert verdict_of(frames_of(1)).phrase == "Use with care: a single frame"
    assert verdict_of(frames_of(0)).phrase == "Do not rely on it: the recording holds no frames"
    assert verdict_of(frames_of(60)).phrase == "Followed in every frame"
    assert verdict_of(wheel_run()).tone is GREEN


def test_a_joined_run_is_judged_by_its_flags_and_its_errors() -> None:
    records = joined_runs()
    evidence = evidence_of(records[2], records)
    assert evidence.slip == pytest.approx(0.05, abs=1e-5)
    assert evidence.doubtful == pytest.approx(0.01875, abs=1e-5)
    assert evidence.coasting == pytest.approx(0.1, abs=1e-5)
    assert not_none(evidence.off_m) == not_none(records[2].evaluation).ate.translation.rmse
    assert evidence.refused == 0.0025  # two of 800 readings
    hazy = tuple(replace(frame, flags=("degenerate",)) for frame in records[2].frames)  # 10 % of them coasting
    assert evidence_of(replace(records[2], frames=hazy), records).degenerate == pytest.approx(0.9, abs=1e-4)
    assert evidence_of(replace(records[2], frames=()), records).degenerate == 0
    assert verdict_of_run(records).tone is GREEN
    bold = (*records[:2], joined_run(boldness=20))
    assert about(verdict_of_run(bold), "3σ").tone is not GREEN
    assert verdict_of_run(bold).tone is not GREEN


def test_of_several_that_are_not_joined_each_is_named() -> None:
    wheels, camera = replace(wheel_run(), odometry="wheels"), replace(empty_run(), odometry="features")
    verdict = verdict_of_run([wheels, camera])
    assert verdict.tone is AMBER  # the wheels may serve
    assert verdict.phrase == "Use with care: features: no pose was found"
    assert {found.sentence.split(":")[0] for found in verdict.findings} == {"Wheels", "Features"}
    assert verdict_of_run([wheels, wheels]).tone is GREEN
    assert verdict_of_run([camera, camera]).tone is RED


def test_frames_that_were_dropped_are_counted_once() -> None:
    run = frames_of(50, association=AssociationReport(80, 75, 55, 0.02), realtime=RealTimeRecord(2.0, 55, 5, 2, 100))
    unread = FrameRecord(50, 60.0, Status.TRACKING, Reason.FRAME_UNUSABLE, 0, 0, 0.0, is_unread=True)
    repeat = FrameRecord(51, 60.1, Status.TRACKING, Reason.REPEATED, 0, 0, 0.0)
    drops = not_none(replace(run, frames=(*run.frames[:49], unread, repeat)).drops)
    assert drops == FrameDrops(75, unpaired=20, unreadable=1, overtaken=5, undecoded=2)
    assert (drops.total, drops.share) == (26, 26 / 75)
    assert drops.sentence == "26 of 75 frames dropped (34.7 %): 20 without a partner, 1 unreadable, 5 overtaken"
    assert wheel_run().drops is None
    assert not_none(replace(run, is_interrupted=True).drops).unpaired == 0  # what it did not reach is not lost


def test_speed_is_that_of_the_camera_with_all_its_frames() -> None:
    run = example_run(500)
    assert "times as fast as the camera" in " ".join(verdict_of(run).facts)
    slow = replace(run, frames=tuple(replace(f, seconds=0.1) for f in run.frames))
    assert (
        "the camera delivers 3.0 in that time: lower its rate, or in real time frames are dropped."
        in verdict_of(slow).facts[-1]
    )
    half = replace(frames_of(50), association=AssociationReport(100, 100, 50, 0.02))
    assert "50 times as fast" in verdict_of(half).facts[-1]  # a frame a second is used, of two that came
    live = replace(frames_of(50), realtime=RealTimeRecord(20.0, 240, 190, 0, 1000, 0.031, 0.052))
    verdict = verdict_of(live)
    assert verdict.facts[-1] == "Played in real time: 2.5 frames/s answered, latency 31 ms median, 52 ms 95 %."
    assert verdict.findings[0].sentence == "190 of 240 frames dropped (79.2 %): 190 overtaken."
    assert "as fast as the camera" not in " ".join(verdict.sentences)
    assert verdict.phrase == "Do not rely on it: 79.2 % of frames were dropped"


def test_accuracy_is_that_from_the_truth_or_why_it_is_not_known() -> None:
    run = example_run(500)
    ate = not_none(run.evaluation).ate.translation
    assert f"{100 * ate.rmse:.2f} cm (RMSE) and by {100 * ate.max:.2f} cm at worst" in verdict_of(run).facts[0]
    run = example_run(60, with_truth=False)
    assert "cannot be said: there is no ground truth." in verdict_of(run).facts[0]
    run = replace(run, evaluation_problem="they share 0.1 s.")
    assert "cannot be said: they share 0.1 s." in verdict_of(run).facts[0]


def test_a_known_map_says_whether_when_where_and_how_surely() -> None:
    assert RECOGNISED.sentence == (
        "Recognised in the map monday after 400 ms, at x 1.20 m, y -0.30 m, heading 86° (1σ 2.00 cm and 0.573°); "
        "5 views of the map seen again"
    )
    camera = replace(RECOGNISED, yaw_rad=None, sigma_m=None)
    assert "y -0.30 m, z 0.00 m (how surely is not known)" in camera.sentence
    assert "only after the drive" in replace(RECOGNISED, after_s=None).sentence
    assert "there are no poses in it" in KnownMapRecord("monday").sentence
    assert "rest on --start alone" in KnownMapRecord("monday", has_start=True).sentence


def test_notes_name_all_that_was_left_out() -> None:
    run = example_run(500)
    found = notes(run)
    assert found[0] == run.warnings[0]
    assert "2 frames could not be used: depth image is truncated (2)." in found
    assert any("60 used frames gave no pose: too few matches (49), too few inliers (11)." in note for note in found)
    assert "12 of 512 colour images and 3 of 503 depth images found no partner within 20 ms and were left out." in found
    assert notes(replace(run, faults=run.warnings))[0] != run.warnings[0]  # the verdict has it


def test_notes_name_what_the_truth_does_not_cover() -> None:
    run = example_run(300)
    half = replace(run, evaluation=replace(not_none(run.evaluation), pairs=100, scale=1.25))
    text = " ".join(notes(half))
    assert f"Only 100 of {len(run.estimate)} poses have a true pose" in text
    assert "multiplied by 1.25000" in text


def test_a_clean_run_needs_no_note() -> None:
    assert notes(frames_of(2)) == []


def test_many_reasons_are_summed_up() -> None:
    frames = tuple(
        FrameRecord(i, START_S + i, Status.TRACKING, Reason.FRAME_UNUSABLE, 0, 0, 0.0, f"image {i} is missing")
        for i in range(50)
    )
    assert "other reasons (42)" in notes(replace(empty_run(), frames=frames))[0]


def test_the_verdict_of_metrics_json_is_the_same() -> None:
    records = joined_runs()
    verdict = verdict_of(records[2], records)
    written = verdict.to_dict()
    assert (written["tone"], written["phrase"]) == (verdict.tone, verdict.phrase)
    assert [found["sentence"] for found in written["findings"]] == [found.sentence for found in verdict.findings]
    assert np.isin([found["tone"] for found in written["findings"]], ["green", "amber", "red"]).all()
