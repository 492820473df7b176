"""The verdict on a run, by its figures, for report, terminal and metrics.json. Holds a run's key figures and the
figures of joined sensors.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from enum import StrEnum
from itertools import takewhile
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from wheelsight.app.run import words
from wheelsight.app.run.run_record import FrameDrops, FrameRecord, KnownMapRecord, RunRecord
from wheelsight.core.errors import EvaluationError
from wheelsight.core.estimates import Reason, Status
from wheelsight.core.messages import NOTHING_MEASURED
from wheelsight.evaluation import Consistency, consistency


class Tone(StrEnum):
    """How far to trust a run, from best to worst."""

    GREEN = "green"
    AMBER = "amber"
    RED = "red"


_BADNESS = {tone: number for number, tone in enumerate(Tone)}
_CARE = {Tone.AMBER: "Use with care", Tone.RED: "Do not rely on it"}

# Limits for amber and red. Share of frames without a pose: good recordings lose a few per cent to dropped images and
# blur; with more gaps than poses there is no path.
_WITHOUT_POSE = (0.05, 0.5)
# Share of time with slip: a door sill or a wet patch takes seconds of a minute. A third of a drive means a wrong
# calibration of wheels or camera.
_SLIP = (0.1, 0.3)
# Share of time in which wheels and camera contradict each other and the faulty one is unknown.
_DOUBTFUL = (0.05, 0.2)
# Share of time with degenerate images. Corridors cause them and wheels bridge them, so it is never red.
_DEGENERATE = (0.5, 1.0)
# Share of time on wheels alone: 5 s of 45 with a covered lens cost a few centimetres; over half, no camera checks the
# drive.
_COASTING = (0.15, 0.5)
# Share of time with the true position beyond the stated 3σ: 0.3 % for correct covariances.
_BEYOND_3_SIGMA = (0.05, 0.2)
# Share of dropped frames: `info` warns at the same share of images without a partner.
_DROPPED = (0.02, 0.3)
# Share of frames overtaken in real time: at 30 a second one in ten changes no pose.
_OVERTAKEN = (0.1, 0.3)
# Share of rejected wheel readings: damaged lines are one in thousands. Never red: a camera alone may do well.
_REFUSED = (0.01, 1.0)
# RMSE over the length of the true path: wheels with data-sheet sizes err by some per cent.
_OFF_THE_WAY = (0.05, 0.15)
# Errors below these, metres, are never amber, or red: ground truth of a Kinect's tracker is good to 2 cm.
_LEAST_OFF_M = (0.02, 0.1)
# Ratio to the error of the better sensor alone, and difference in metres: joining should help.
_WORSE_THAN_ALONE, _WORSE_M = (1.2, 3.0), (0.01, 0.1)
# Share of rejected loops: a few places look alike anywhere, more in a building of equal rooms.
_REFUSED_LOOPS = (0.5, 1.0)
# Path length, metres, above which loops are expected: a drift of about 1 % gives 20 cm there.
_LONG_WAY_M = 20.0
# Standard deviation in a known map, metres: beyond a robot's length it may be another door.
_SIGMA_IN_MAP_M = (0.5, 2.0)

_CALIBRATE = "calibrate wheels and mount (wheelsight calibrate wheels, wheelsight calibrate base)"
_SLOWER = "drive and turn more slowly, or take more images a second"
_BY_TEXTURE = "give it more light, or turn the camera to where there is more to see; --odometry dense goes by surfaces"
_STAMPS = "stamp all sensors by one clock (wheelsight info shows their times)"
_READINGS = "check ticks a turn, counter_bits and max_speed_m_s of the wheels' calibration, and the line"
_REMEDIES: Mapping[Reason, str] = {
    Reason.FRAME_UNUSABLE: "see the notes for what was wrong with the images, and record them again",
    Reason.TOO_FEW_KEYPOINTS: _BY_TEXTURE,
    Reason.TOO_FEW_MATCHES: _SLOWER,
    Reason.TOO_FEW_INLIERS: _SLOWER,
    Reason.DEGENERATE: "let the camera see more than one wall or floor, or join wheels",
    Reason.TOO_LITTLE_DEPTH: "uncover the camera, and keep it as far from things as it can measure",
    Reason.TOO_LITTLE_OVERLAP: _SLOWER,
    Reason.POOR_FIT: "check the lens (wheelsight calibrate camera), and keep people out of most of the view",
    Reason.NOT_RECOGNISED: "drive to a place seen before, looking the same way as then",
    Reason.SURFACES_CONTRADICTED: _SLOWER,
    Reason.IMPLAUSIBLE_MOTION: _READINGS,
    Reason.CLOCK_BACKWARDS: _STAMPS,
    Reason.GAP: "read the wheels at 20 a second or more, without pauses",
    Reason.COUNTER_AMBIGUOUS: "set max_speed_m_s of the wheels to what the robot does, or read them more often",
    Reason.INVALID: _READINGS,
    Reason.TOO_LATE: _STAMPS,
    Reason.CLOCKS_APART: _STAMPS,
    Reason.CONTRADICTION: "find what is wrong by wheelsight calibrate base: mount, wheels, or depth factor",
}
_MISPLACED = "calibrate the camera (wheelsight calibrate camera): lens, or depth beside colour, is not what it says"
_CORRECT = "correct what the warning about the sensors names, and run again"
_FEWER_DROPS = "drop fewer frames: the camera moves too far between two that are used"
_IN_MAP = "drive slowly past what the map shows, looking the same way, or say where it begins (--start X,Y,YAW)"
_SEE_ROWS = "see status.csv for the reason of each frame"


@dataclass(frozen=True, slots=True)
class Finding:
    """One fact that affects the verdict.

    Attributes:
        about: topic, such as "slip".
        tone: how far it lets the run be trusted.
        short: a few words.
        sentence: with its numbers.
        remedy: what to do; "" if green.
    """

    about: str
    tone: Tone
    short: str
    sentence: str
    remedy: str = ""

    @property
    def line(self) -> str:
        """The sentence with its remedy."""
        return self.sentence if not self.remedy else f"{self.sentence} To do: {self.remedy}."


@dataclass(frozen=True, slots=True)
class RunVerdict:
    """The verdict on a run.

    Attributes:
        phrase: a few words.
        tone: the worst of its findings.
        findings: the worst first.
        facts: neutral sentences on accuracy and speed.
    """

    phrase: str
    tone: Tone
    findings: tuple[Finding, ...]
    facts: tuple[str, ...] = ()

    @property
    def concerns(self) -> tuple[Finding, ...]:
        """Red and amber findings."""
        return tuple(found for found in self.findings if found.tone is not Tone.GREEN)

    @property
    def sentences(self) -> tuple[str, ...]:
        """All sentences, findings first."""
        return (*(found.line for found in self.findings), *self.facts)

    def to_dict(self) -> dict[str, Any]:
        """For metrics.json."""
        return {"tone": str(self.tone), "phrase": self.phrase, "findings": [asdict(found) for found in self.findings]}


@dataclass(frozen=True, slots=True)
class Evidence:
    """The figures behind a verdict. The defaults are those of a sound run.

    Attributes:
        unit, is_joined: as in the record.
        frames, posed, lost_episodes, lost_s: as in `Summary`.
        failures: (reason, why, count) of frames without a motion, most frequent first.
        drops: frames that were not used.
        left_out: unused lines or messages of the recording: (count, total) by reason.
        most_overtaken: share of overtaken frames above which the tone is amber.
        slip, doubtful, degenerate: shares of the time, 0 to 1; None if the filter has no such flag.
        coasting: share of the time on wheels alone; `coasting_s` has the length of each stretch.
        refused: share of rejected wheel readings; `refused_why` is the chief reason.
        beyond_3_sigma: share of the time with the true position beyond the stated 3σ; None without a truth.
        off_m, way_m: RMSE of the position error, and length of the true path; None without a truth.
        alone: (name, RMSE in metres) of the better sensor alone, or None.
        areas_left: error of the rectified wheels over that of the wheels; None without areas.
        loops: (kept, refused, whether all pieces are joined) if loops were requested, else None.
        known_map: recognition in a known map; None without one.
        faults: sensor faults that were found during the run.
        length_m: of the estimate.
    """

    unit: str = "frame"
    is_joined: bool = False
    frames: int = 1
    posed: int = 1
    lost_episodes: int = 0
    lost_s: float = 0.0
    failures: tuple[tuple[Reason, str, int], ...] = ()
    drops: FrameDrops = field(default_factory=FrameDrops)
    left_out: dict[str, tuple[int, int]] = field(default_factory=dict)
    most_overtaken: float = _OVERTAKEN[0]
    slip: float | None = None
    doubtful: float | None = None
    degenerate: float | None = None
    coasting: float = 0.0
    coasting_s: tuple[float, ...] = ()
    refused: float = 0.0
    refused_why: Reason | None = None
    beyond_3_sigma: float | None = None
    off_m: float | None = None
    way_m: float = 0.0
    alone: tuple[str, float] | None = None
    areas_left: float | None = None
    loops: tuple[int, int, bool] | None = None
    known_map: KnownMapRecord | None = None
    faults: tuple[str, ...] = ()
    length_m: float = 0.0


def evidence_of(record: RunRecord, records: Sequence[RunRecord] = ()) -> Evidence:
    """The figures of `record` for its verdict; `records` are all of the same run, with `record`."""
    summary, found = summarise(record), record.evaluation
    by_reason = Counter((f.reason, f.why) for f in record.frames if f.reason is not None and not f.is_repeat)
    evidence: dict[str, Any] = {
        "unit": record.unit,
        "is_joined": record.is_joined,
        "frames": summary.frames,
        "posed": summary.posed,
        "lost_episodes": summary.lost_episodes,
        "lost_s": summary.lost_s,
        "failures": tuple((reason, why, count) for (reason, why), count in by_reason.most_common()),
        "drops": record.drops or FrameDrops(),
        "left_out": record.left_out,
        "most_overtaken": record.config.get("realtime", {}).get("dropped_share", _OVERTAKEN[0]),
        "known_map": record.known_map,
        "faults": record.faults,
        "length_m": record.estimate.length_m,
    }
    if found is not None:
        evidence |= {"off_m": found.ate.translation.rmse, "way_m": true_way_m(record)}
    if record.rectification is not None and record.rectification.errors is not None:
        evidence["areas_left"] = float(record.rectification.errors.left)
    if record.correction is not None:
        loops = record.correction.found.loops
        evidence["loops"] = len(loops.kept), len(loops.refused), record.correction.is_joined
    return Evidence(**evidence, **(_of_joined(record, records) if record.is_joined else {}))


def _of_joined(record: RunRecord, records: Sequence[RunRecord]) -> dict[str, Any]:
    """Figures of joined sensors."""
    facts, best_alone = facts_of(record), best_alone_of(records)
    evidence: dict[str, Any] = dict(facts.flag_shares)
    if "degenerate" in evidence:  # only frames that the camera tracked: while coasting the view is not the problem
        starts_s, ends_s = record.frame_spans_s()
        lasted_s = ends_s - starts_s
        is_so = np.array([f.status is Status.TRACKING and "degenerate" in f.flags for f in record.frames], bool)
        evidence["degenerate"] = float(lasted_s[is_so].sum() / lasted_s.sum()) if lasted_s.sum() > 0 else 0.0
    evidence |= {"coasting": facts.share_of(Status.COASTING), "coasting_s": facts.coasting_s}
    if facts.consistency is not None and np.isfinite(facts.consistency.share):
        evidence["beyond_3_sigma"] = 1 - facts.consistency.share
    if best_alone is not None and record.evaluation is not None:
        evidence["alone"] = best_alone.odometry, record.evaluation.ate.translation.rmse / best_alone.ratio
    wheels = next((one for one in records if one.odometry == "wheels"), None)
    if wheels is not None and wheels.frames:
        refused = Counter(frame.reason for frame in wheels.frames if frame.reason is not None)
        evidence["refused"] = refused.total() / len(wheels.frames)
        evidence["refused_why"] = next((reason for reason, _ in refused.most_common(1)), None)
    return evidence


def true_way_m(record: RunRecord) -> float:
    """Length of the true path while the odometry had poses, 0 without a truth. The estimate's own length grows with
    noise.
    """
    if record.ground_truth is None or not len(record.estimate):
        return 0.0
    return record.ground_truth.between(*record.estimate.stamps_s[[0, -1]].tolist()).length_m


def judge(evidence: Evidence) -> RunVerdict:
    """The verdict by its evidence. A worse figure never gives a better tone."""
    found = sorted(_findings(evidence), key=lambda one: -_BADNESS[one.tone])
    tone = found[0].tone
    if evidence.faults:  # the cause comes first
        tone = max(tone, Tone.AMBER, key=_BADNESS.__getitem__)
        faults = []
        for sentence in evidence.faults:
            what, separator, _ = sentence.partition("; ")
            short = (what if separator else sentence.rpartition(": ")[0] or sentence).rstrip(".")
            remedy = "correct what this names, and run again"
            faults.append(Finding("sensors", tone, f"{short[0].lower()}{short[1:]}", sentence, remedy))
        found = [*faults, *found]
    return RunVerdict(_phrase(evidence, found[0]), tone, tuple(found))


def verdict_of(record: RunRecord, records: Sequence[RunRecord] = ()) -> RunVerdict:
    """The verdict on one odometry of a run, with accuracy and speed; `records` as for `evidence_of`."""
    verdict = judge(evidence_of(record, records))
    facts = [accuracy_sentence(record)]
    drift = facts_of(record).consistency if record.is_joined else None
    if drift is not None:
        share = words.percent(drift.drift_share)
        facts.append(f"Begun at the true start, it ends {words.length(drift.drift_m)} off, {share} of the way.")
    facts.append(speed_sentence(record))
    return RunVerdict(verdict.phrase, verdict.tone, verdict.findings, tuple(filter(None, facts)))


def verdict_of_run(records: Sequence[RunRecord]) -> RunVerdict:
    """The verdict on a run: on joined sensors or on its only odometry, else on all odometries side by side."""
    main = joined_of(records) or (records[0] if len(records) == 1 else None)
    if main is not None:
        return verdict_of(main, records)
    of_each = [(record.odometry, verdict_of(record, records)) for record in records]
    tones = {verdict.tone for _, verdict in of_each}
    tone = tones.pop() if len(tones) == 1 else Tone.AMBER  # one of them may serve
    named = [
        Finding(one.about, one.tone, f"{name}: {one.short}", f"{name.capitalize()}: {one.sentence}", one.remedy)
        for name, verdict in of_each
        for one in verdict.findings
    ]
    named.sort(key=lambda one: -_BADNESS[one.tone])
    phrase = "Each was followed" if tone is Tone.GREEN else f"{_CARE[tone]}: {named[0].short}"
    return RunVerdict(phrase, tone, tuple(named))


def _findings(e: Evidence) -> Iterator[Finding]:
    if e.known_map is not None:
        yield _in_map(e.known_map)
    yield _poses(e)
    yield from _drops(e)
    # Unused readings and true poses of the recording
    if e.left_out:
        share = max(count / max(of, 1) for count, of in e.left_out.values())
        tone = _graded(share, _DROPPED)
        causes = "; ".join(f"{count:,} of {of:,}: {why}" for why, (count, of) in e.left_out.items())
        total = sum(count for count, _ in e.left_out.values())
        remedy = "see the notes: repair the stamps, or record again"
        yield _finding("left out", tone, f"{total:,} readings were left out", f"Left out were {causes}.", remedy)
    if e.is_joined:
        yield _coasting(e)
        if e.slip is not None:
            sentence = "The wheels were held to slip in {} of the time."
            remedy = f"if that was all along, {_CALIBRATE}; if at one place, drive slowly over it"
            yield _share_finding("slip", e.slip, _SLIP, sentence if e.slip else "The wheels never slipped.", remedy)
        if e.doubtful is not None:
            sentence = (
                "Wheels and camera contradicted each other in {} of the time, and it was not known which was right."
            )
            sentence = sentence if e.doubtful else "Wheels and camera never contradicted each other."
            yield _share_finding("doubtful", e.doubtful, _DOUBTFUL, sentence, _CORRECT if e.faults else _CALIBRATE)
        if e.degenerate is not None:
            sentence = "The images did not show all directions of motion in {} of the time: the wheels filled in."
            sentence = sentence if e.degenerate else "The images showed all directions of motion."
            remedy = "turn the camera so that it sees more than one wall or floor"
            yield _share_finding("degenerate", e.degenerate, _DEGENERATE, sentence, remedy)
        if e.refused:
            why = "" if e.refused_why is None else f": {e.refused_why}"
            remedy = _READINGS if e.refused_why is None else _REMEDIES.get(e.refused_why, _READINGS)
            found = _share_finding(
                "wheels", e.refused, _REFUSED, "{} of wheel readings were refused" + why + ".", remedy
            )
            yield replace(found, short=f"{words.percent(e.refused)} of wheel readings were refused")
    yield from _accuracy(e)
    if e.loops is not None:
        yield _loops(*e.loops, is_drift_long=e.length_m > _LONG_WAY_M and e.known_map is None)


def _poses(e: Evidence) -> Finding:
    if not e.frames:
        text = f"The recording holds no {e.unit}s."
        return Finding("poses", Tone.RED, text[:-1].lower(), text, "check it by wheelsight info")
    share = e.posed / e.frames
    sentence = f"{e.posed:,} of {words.count(e.frames, e.unit)} ({words.percent(share)}) have a pose"
    tone = _graded(1 - share, _WITHOUT_POSE) if e.posed else Tone.RED
    if e.lost_episodes:
        tone = max(tone, Tone.AMBER, key=_BADNESS.__getitem__)
        sentence += f"; it was lost {words.times(e.lost_episodes)}, for {words.duration(e.lost_s)} in all"
    if e.frames == 1 and e.posed:
        sentence, remedy = f"There is a single {e.unit}, and nothing to follow.", "take a longer recording"
        return Finding("poses", Tone.AMBER, f"a single {e.unit}", sentence, remedy)
    without = f"a pose in every {e.unit}" if share == 1 else f"{words.percent(1 - share)} of {e.unit}s have no pose"
    short = without if e.posed else "no pose was found"
    short = f"it was lost {words.times(e.lost_episodes)}" if e.posed and e.lost_episodes and share > 0.5 else short
    why = _chief_failures(e) if tone is not Tone.GREEN else ""
    return _finding("poses", tone, short, f"{sentence}{why}.", _remedy(e))


def _drops(e: Evidence) -> Iterator[Finding]:
    drops = e.drops
    if not drops.total:
        return
    lost = (drops.unpaired + drops.unreadable) / drops.came
    limits = (e.most_overtaken, max(_OVERTAKEN[1], e.most_overtaken))
    tone = max(_graded(lost, _DROPPED), _graded(drops.overtaken / drops.came, limits), key=_BADNESS.__getitem__)
    tone = max(tone, _graded(drops.share, (1.0, _DROPPED[1])), key=_BADNESS.__getitem__)
    if drops.overtaken >= max(drops.unpaired, drops.unreadable):
        slow = "disk or decoding of images is" if drops.undecoded > drops.overtaken / 2 else "computer is"
        remedy = f"lower the camera's rate or size, end other programs, or give --profile pi: the {slow} too slow"
    elif drops.unpaired >= drops.unreadable:
        remedy = "see in wheelsight info how far apart the stamps of colour and depth are, or which images are missing"
    else:
        remedy = "record again, or copy the recording again: the notes say what is wrong with the images"
    short = f"{words.percent(drops.share)} of frames were dropped"
    yield _finding("drops", tone, short, f"{drops.sentence}.", remedy)


def _coasting(e: Evidence) -> Finding:
    tone = _graded(e.coasting, _COASTING)
    if not e.coasting:
        return Finding("coasting", tone, "never coasting", "The camera led throughout.")
    share, whole = words.percent(e.coasting), words.duration(sum(e.coasting_s))
    sentence = f"It coasted on the wheels {words.times(len(e.coasting_s))}, for {whole} in all ({share} of the time)"
    sentence += f", {words.duration(max(e.coasting_s))} at most" if len(e.coasting_s) > 1 else ""
    if tone is Tone.GREEN:
        return Finding("coasting", tone, f"coasting {share}", f"{sentence}.")
    short = f"coasting in {share} of the time"
    return Finding("coasting", tone, short, f"{sentence}{_chief_failures(e)}.", _remedy(e))


def _accuracy(e: Evidence) -> Iterator[Finding]:
    """Findings by the ground truth, if there is one."""
    if e.beyond_3_sigma is not None:
        within = words.percent(1 - e.beyond_3_sigma)
        tone = _graded(e.beyond_3_sigma, _BEYOND_3_SIGMA)
        sentence = f"The position is within its stated 3σ in {within} of the time."
        remedy = f"do not rely on its covariances; {_CALIBRATE}"
        only = "" if tone is Tone.GREEN else " of the time only"
        yield _finding("3σ", tone, f"within the stated 3σ {within}{only}", sentence, remedy)
    if e.off_m is not None and e.way_m > 0:
        tone = _graded(e.off_m / e.way_m, _OFF_THE_WAY, e.off_m, _LEAST_OFF_M)
        share = words.percent(e.off_m / e.way_m)
        sentence = f"The error (RMSE) is {words.length(e.off_m)}, {share} of the way."
        remedy = "close loops (--loops keyframes), join wheels, or check the lens (wheelsight calibrate camera)"
        if e.is_joined:
            remedy = f"{_CALIBRATE}, or close loops (--loops keyframes)"
        elif e.unit == "reading":
            remedy = "calibrate the wheels (wheelsight calibrate wheels), or join a camera"
        short = f"{words.length(e.off_m)} off on {words.length(e.way_m)}"
        yield _finding("error", tone, short, sentence, remedy)
    if e.off_m is not None and e.alone is not None and e.alone[1] > 0:
        name, alone_m = e.alone
        ratio = e.off_m / alone_m
        tone = _graded(ratio, _WORSE_THAN_ALONE, e.off_m - alone_m, _WORSE_M)
        sentence = f"Joined, the error is {words.number(ratio, 2)} times that of {name} alone."
        short = f"{words.number(ratio, 2)} times the error of {name} alone"
        yield _finding("joining", tone, short, sentence, _CALIBRATE)
    if e.areas_left is not None and np.isfinite(e.areas_left):
        tone = Tone.AMBER if e.areas_left > 1 else Tone.GREEN
        sentence = f"Areas leave {words.percent(e.areas_left)} of the wheels' error."
        remedy = "train the areas on drives of this building (wheelsight places train)"
        yield _finding("areas", tone, f"areas leave {words.percent(e.areas_left)} of the error", sentence, remedy)


def _loops(kept: int, refused: int, is_joined: bool, *, is_drift_long: bool) -> Finding:
    sentence = f"{words.count(kept, 'loop')} kept, {refused:,} refused"
    back = "drive back through places seen before, looking the same way as then"
    if not is_joined:
        sentence += "; after the camera was lost, its place was not recognised again"
        return Finding("loops", Tone.AMBER, "its place was not recognised again", f"{sentence}.", back)
    if not kept and is_drift_long:
        return Finding("loops", Tone.AMBER, "no loop was closed", f"{sentence}: nothing corrects the drift.", back)
    if not kept + refused:
        return Finding("loops", Tone.GREEN, "no loop was closed", f"{sentence}.")
    tone = _graded(refused / (kept + refused), _REFUSED_LOOPS)
    remedy = "see the plan of the loops: places look alike, or the path is wrong"
    return _finding("loops", tone, f"{refused:,} of {kept + refused:,} loops were refused", f"{sentence}.", remedy)


def _in_map(found: KnownMapRecord) -> Finding:
    short, tone = "recognised in the map", Tone.GREEN
    if not found.is_recognised:
        tone = Tone.AMBER if found.has_start else Tone.RED
        short = "the place was not recognised in the map"
    elif found.after_s is None:
        short, tone = "recognised in the map only after the drive", Tone.AMBER
    elif found.sigma_m is not None and found.sigma_m > _SIGMA_IN_MAP_M[0]:
        short, tone = "hardly known where in the map", _graded(found.sigma_m, _SIGMA_IN_MAP_M)
    elif found.keyframes_placed < found.keyframes:
        short, tone = "not all of the drive lies in the map", Tone.AMBER
    unplaced = found.keyframes - found.keyframes_placed
    more = ""
    if unplaced and found.is_recognised:
        more = f"; where {unplaced:,} of {found.keyframes:,} keyframes lie in it is not known"
    return _finding("map", tone, short, f"{found.sentence}{more}.", _IN_MAP)


def _finding(about: str, tone: Tone, short: str, sentence: str, remedy: str) -> Finding:
    """A finding, whose remedy is left out if it is green."""
    return Finding(about, tone, short, sentence, "" if tone is Tone.GREEN else remedy)


def _share_finding(about: str, share: float, limits: tuple[float, float], sentence: str, remedy: str) -> Finding:
    tone, said = _graded(share, limits), words.percent(share)
    text = sentence.format(said)
    if tone is Tone.GREEN:
        return Finding(about, tone, f"{about} {said}", text)
    return Finding(about, tone, f"{about} in {said} of the time", text, remedy)


def _graded(
    value: float, limits: tuple[float, float], also: float = float("inf"), also_over: tuple[float, float] = (0.0, 0.0)
) -> Tone:
    """Tone by limits for amber and red. A second value, if given, must exceed its own limits, too."""
    amber, red = (value > limit and also > least for limit, least in zip(limits, also_over, strict=True))
    return Tone.RED if red else Tone.AMBER if amber else Tone.GREEN


def _chief_failures(e: Evidence) -> str:
    """The most frequent reasons for missing motions."""
    return "".join(f", {why} ({count:,})" for _, why, count in e.failures[:2]).replace(", ", ": ", 1)


def _remedy(e: Evidence) -> str:
    if e.faults:
        return _CORRECT
    if e.known_map is not None and not e.known_map.is_recognised:
        return _IN_MAP
    if e.drops.share > _DROPPED[1]:
        return _FEWER_DROPS
    if not e.failures:
        return _SEE_ROWS
    reason, why, _ = e.failures[0]
    if why == NOTHING_MEASURED:
        return _REMEDIES[Reason.TOO_LITTLE_DEPTH]
    return _MISPLACED if why.startswith("the calibration puts") else _REMEDIES.get(reason, _SEE_ROWS)


def _phrase(e: Evidence, worst: Finding) -> str:
    if worst.tone is not Tone.GREEN:
        return f"{_CARE[worst.tone]}: {worst.short}"
    followed = f"followed in every {e.unit}" if e.posed == e.frames else "followed almost throughout"
    if not e.is_joined:
        return f"{followed[0].upper()}{followed[1:]}"
    if e.off_m is None:
        return f"Joined: {followed}, without a truth to compare with"
    phrase = f"Joined: {words.length(e.off_m)} off (RMSE)"
    if e.alone is None or not e.alone[1] > 0:
        return phrase
    ratio = e.off_m / e.alone[1]
    better = ", which did better" if ratio > 1 else ""
    return f"{phrase}, {words.number(ratio, 2)} times the error of {e.alone[0]} alone{better}"


def accuracy_sentence(record: RunRecord) -> str:
    """The error of the path, or why it is unknown; "" without a pose."""
    if not record.posed:
        return ""
    if record.evaluation is None:
        why = record.evaluation_problem or "there is no ground truth"
        return f"How accurate the path is cannot be said: {why.rstrip('.')}."
    error = record.evaluation.ate.translation
    text = f"Laid upon the ground truth, the path errs by {words.length(error.rmse)} (RMSE) "
    text += f"and by {words.length(error.max)} at worst"
    if record.estimate.length_m > 0:
        text += f", on {words.length(record.estimate.length_m)} travelled"
    return text + "."


def speed_sentence(record: RunRecord) -> str:
    """Whether processing keeps up with the sensor; "" without times."""
    if record.realtime is not None:
        return f"{record.realtime.sentence[0].upper()}{record.realtime.sentence[1:]}."
    summary = summarise(record)
    if not summary.median_s > 0:
        return ""
    text = f"A {summary.unit} takes {words.duration(summary.median_s)} at the median"
    source = "camera delivers" if summary.unit == "frame" else "wheels deliver"
    kept = 1.0 if record.drops is None else 1 - record.drops.share  # dropped frames count for the rate
    ratio = kept * summary.frame_period_s / summary.median_s
    if not ratio > 0:
        return text + "."
    if ratio >= 1:
        return f"{text}, {words.number(ratio, 2)} times as fast as the {source} them."
    more = words.number(1 / ratio, 2)
    return f"{text}; the {source} {more} in that time: lower its rate, or in real time frames are dropped."


_MOST_REASONS = 8


def notes(record: RunRecord) -> list[str]:
    """Sentences on skipped, unmatched or unknown data that the verdict does not have."""
    summary = summarise(record)
    found = [warning for warning in record.warnings if warning not in record.faults]
    if summary.skipped:
        found.append(f"{words.count(summary.skipped, summary.unit)} could not be used: {_counted(summary.skips)}.")
    if summary.failures:
        failed = sum(n for _, n in summary.failures)
        which, why = words.count(failed, f"used {summary.unit}"), _counted(summary.failures)
        without = "gave no motion, so that the wheels led there" if record.is_joined else "gave no pose"
        found.append(f"{which} {without}: {why}.")
    if summary.failures and record.unit == "reading":
        found.append(
            "After a reading without a pose the path goes on from where it was: the motion between is not known."
        )
    pairing = record.association
    if pairing is not None and (pairing.dropped_color or pairing.dropped_depth):
        found.append(
            f"{pairing.dropped_color:,} of {words.count(pairing.color_images, 'colour image')} and "
            f"{pairing.dropped_depth:,} of {words.count(pairing.depth_images, 'depth image')} found no partner within "
            f"{1e3 * pairing.max_gap_s:g} ms and were left out."
        )
    evaluation = record.evaluation
    if evaluation is not None and evaluation.pairs < record.posed:
        found.append(
            f"Only {evaluation.pairs:,} of {words.count(record.posed, 'pose')} have a true pose beside them; "
            "errors speak of these alone."
        )
    if evaluation is not None and evaluation.scale is not None:
        found.append(f"Positions were multiplied by {evaluation.scale:.5f} to fit the ground truth.")
    return found


def _counted(reasons: tuple[tuple[str, int], ...]) -> str:
    text = ", ".join(f"{why} ({n:,})" for why, n in reasons[:_MOST_REASONS])
    others = sum(n for _, n in reasons[_MOST_REASONS:])
    return f"{text}, other reasons ({others:,})" if others else text


SKIPPED = "skipped"
# A first frame that compiles or loads kernels is slower than the usual one by at least this factor. Fewer frames than
# the second number give no usual time.
_COLD_TIMES, _LEAST_FRAMES = 10.0, 10


@dataclass(frozen=True, slots=True)
class Summary:
    """The key figures of a run.

    Attributes:
        frames: number of listed frames; a repeated image counts as skipped only.
        skipped: number of unusable frames.
        posed: number of frames with a pose in the trajectory.
        duration_s: from the first frame to the last.
        frame_period_s: median time between frames, NaN with fewer than two.
        length_m: length of the estimate.
        lost_episodes: number of times the camera was lost.
        lost_s: total time lost.
        failures: (why, count) of used frames without a pose, most frequent first.
        skips: (why, count) of unusable frames, most frequent first.
        median_s: median processing time of a used frame; NaN without any.
        p95_s: 95th percentile of the processing time.
        longest_s: maximum of the processing time.
        unit: "frame", or "reading" for wheel readings.
    """

    frames: int
    skipped: int
    posed: int
    duration_s: float
    frame_period_s: float
    length_m: float
    lost_episodes: int
    lost_s: float
    failures: tuple[tuple[str, int], ...]
    skips: tuple[tuple[str, int], ...]
    median_s: float
    p95_s: float
    longest_s: float
    unit: str = "frame"

    @property
    def pose_share(self) -> float:
        """Share of listed frames with a pose; 0 without frames."""
        return self.posed / self.frames if self.frames else 0.0

    @property
    def frames_per_second(self) -> float:
        """Frames a second at the median time a frame."""
        return 1 / self.median_s if self.median_s > 0 else float("nan")


def summarise(record: RunRecord) -> Summary:
    """The key figures of `record`."""
    frames = [frame for frame in record.frames if not frame.is_repeat]
    stamps_s = np.array([frame.stamp_s for frame in frames])
    seconds = np.array([frame.seconds for frame in frames if not frame.is_skipped and np.isfinite(frame.seconds)])
    lost = lost_spans_s(record)
    used = [frame for frame in frames if not frame.is_skipped]
    skips = Counter(frame.why for frame in record.frames if frame.is_skipped)
    failures = Counter(frame.why for frame in used if frame.reason is not None)
    return Summary(
        frames=len(frames),
        skipped=len(record.frames) - len(used),
        posed=record.posed,
        duration_s=float(np.ptp(stamps_s)) if len(frames) else 0.0,
        frame_period_s=float(np.median(np.diff(stamps_s))) if len(frames) > 1 else float("nan"),
        length_m=record.estimate.length_m,
        lost_episodes=len(lost),
        lost_s=sum(end - start for start, end in lost),
        failures=tuple(failures.most_common()),
        skips=tuple(skips.most_common()),
        median_s=_percentile(seconds, 50),
        p95_s=_percentile(seconds, 95),
        longest_s=_percentile(seconds, 100),
        unit=record.unit,
    )


def cold_frames(record: RunRecord) -> tuple[FrameRecord, ...]:
    """The first frames, if compiling or loading kernels made them far slower than usual."""
    used = [frame for frame in record.frames if not frame.is_skipped and np.isfinite(frame.seconds)]
    if len(used) < _LEAST_FRAMES:
        return ()
    limit_s = _COLD_TIMES * float(np.median([frame.seconds for frame in used]))
    return tuple(takewhile(lambda frame: frame.seconds > limit_s, used))


def lost_spans_s(record: RunRecord) -> list[tuple[float, float]]:
    """(first lost stamp, next stamp that is not lost) of each time the camera was lost, with unusable frames."""
    frames = record.frames
    lost = [(i, j) for i, j, status in runs([str(frame.status) for frame in frames]) if status == Status.LOST]
    return [(frames[i].stamp_s, frames[min(j, len(frames) - 1)].stamp_s) for i, j in lost]


def _percentile(values: np.ndarray, percent: float) -> float:
    return float(np.percentile(values, percent)) if len(values) else float("nan")


JOINED = "joined"
_NO_SENSORS = (JOINED, "rectified")
FLAGS = ("slip", "doubtful", "degenerate")
_MOST_OF_THE_TIME = 0.95
_FACTS: WeakKeyDictionary[RunRecord, JoinedFacts] = WeakKeyDictionary()


@dataclass(frozen=True, slots=True, eq=False)
class JoinedFacts:
    """Figures of a joined run. The status of a frame holds until the next frame.

    Attributes:
        seconds: total time of each status that occurred.
        coasting_s: length of each stretch without a camera, seconds.
        flag_shares: share of the time, 0 to 1, with each flag; empty if the filter has none.
        poses_at_frames: number of poses at frames.
        poses_at_readings: number of poses at wheel readings alone.
        consistency: errors beside their stated uncertainty, or None without truth or covariances.
    """

    seconds: dict[str, float]
    coasting_s: tuple[float, ...]
    flag_shares: dict[str, float]
    poses_at_frames: int
    poses_at_readings: int
    consistency: Consistency | None

    def share_of(self, status: Status) -> float:
        """Share of the time, 0 to 1, with a status; 0 without frames."""
        whole_s = sum(self.seconds.values())
        return self.seconds.get(status.value, 0.0) / whole_s if whole_s > 0 else 0.0


@dataclass(frozen=True, slots=True)
class BestAlone:
    """The better single sensor, and the joined ATE (RMSE) over its ATE: below 1 joining helped."""

    odometry: str
    ratio: float


def joined_of(records: Sequence[RunRecord]) -> RunRecord | None:
    """The record of joined sensors, or None where none were."""
    return next((record for record in records if record.odometry == JOINED), None)


def facts_of(record: RunRecord) -> JoinedFacts:
    """Figures of a joined run. They are cached by record, since page, terminal and metrics use them and 30 minutes cost
    1 s.
    """
    if record not in _FACTS:
        starts_s, ends_s = record.frame_spans_s()
        lasted_s, statuses = ends_s - starts_s, [str(frame.status) for frame in record.frames]
        flags = () if record.config.get("fusion", {}).get("filter") == "ligocki" else FLAGS
        flagged = {flag: np.array([flag in frame.flags for frame in record.frames], bool) for flag in flags}
        whole_s = float(lasted_s.sum())
        coasting = ((i, j) for i, j, status in runs(statuses) if status == Status.COASTING)
        at_frames = int(np.isin(record.estimate.stamps_s, [frame.pose_s for frame in record.frames]).sum())
        _FACTS[record] = JoinedFacts(
            seconds={
                status.value: float(lasted_s[np.array(statuses) == status].sum())
                for status in Status
                if status in statuses
            },
            coasting_s=tuple(float(ends_s[j - 1] - starts_s[i]) for i, j in coasting),
            flag_shares={flag: float(lasted_s[up].sum()) / whole_s if whole_s else 0.0 for flag, up in flagged.items()},
            poses_at_frames=at_frames,
            poses_at_readings=len(record.estimate) - at_frames,
            consistency=consistency_of(record),
        )
    return _FACTS[record]


def consistency_of(record: RunRecord) -> Consistency | None:
    """Errors beside their stated uncertainty, or None without truth or covariances."""
    if record.ground_truth is None or record.evaluation is None:
        return None
    try:
        return consistency(record.estimate, record.ground_truth)
    except EvaluationError:
        return None


def best_alone_of(records: Sequence[RunRecord]) -> BestAlone | None:
    """The most accurate single sensor among those that tracked nearly as long; None without one."""
    joined = joined_of(records)
    if joined is None or joined.evaluation is None:
        return None
    covered = _MOST_OF_THE_TIME * joined.evaluation.truth_time_covered
    rmse_m = {
        record.odometry: record.evaluation.ate.translation.rmse
        for record in records
        if record.evaluation is not None
        and record.odometry not in _NO_SENSORS
        and record.evaluation.truth_time_covered >= covered
    }
    best = min(rmse_m, key=rmse_m.__getitem__, default=None)
    if best is None or not rmse_m[best] > 0:
        return None
    return BestAlone(best, joined.evaluation.ate.translation.rmse / rmse_m[best])


# Where equal labels follow each other.


def runs(labels: list[str]) -> list[tuple[int, int, str]]:
    """Unbroken runs of equal labels, as (first, one past the last, label)."""
    starts = [i for i, label in enumerate(labels) if i == 0 or label != labels[i - 1]]
    return [(i, j, labels[i]) for i, j in zip(starts, [*starts, len(labels)][1:], strict=True)]
