"""The page's part about joined sensors: key figures, and whether it knew its errors."""

from __future__ import annotations

from collections.abc import Iterable

from wheelsight.estimates import Status
from wheelsight.pipeline import words
from wheelsight.pipeline.joined import BestAlone, JoinedFacts
from wheelsight.pipeline.run_record import RunRecord
from wheelsight.report import _html as html
from wheelsight.report import _sections as sections
from wheelsight.report import figures
from wheelsight.report.joined_figures import trust_figure


def tiles(record: RunRecord, facts: JoinedFacts, best_alone: BestAlone | None) -> Iterable[tuple[str, str, str]]:
    """Key figures."""
    if record.evaluation is None:
        yield "ATE, joined", words.UNKNOWN, "not evaluated"
    else:
        more = (
            "RMSE" if best_alone is None else f"{words.number(best_alone.ratio, 2)} times that of {best_alone.odometry}"
        )
        yield "ATE, joined", words.length(record.evaluation.ate.translation.rmse), more
    found = facts.consistency
    if found is not None:
        yield "Within its stated 3σ", words.percent(found.share), "of the time"
        yield "Off at the end", words.length(found.drift_m), f"{words.percent(found.drift_share)} of the way"
    elif record.estimate.covariances is not None and len(record.estimate):
        yield "3σ at the end", words.length(3 * figures.standard_deviations(record.estimate)[0][-1]), "as stated"
    coasting = sum(facts.coasting_s)
    yield (
        "Coasting",
        words.duration(coasting),
        f"{_times(len(facts.coasting_s))}, {words.duration(max(facts.coasting_s))} at most" if coasting else "never",
    )
    if facts.flag_shares:
        (first, share), *others = facts.flag_shares.items()
        yield f"Flagged: {first}", _share(share), ", ".join(f"{flag} {_share(share)}" for flag, share in others)


def section(record: RunRecord, facts: JoinedFacts) -> str:
    """Errors beside what was said of them, statuses and flags, on one time axis; the camera's matches below."""
    key, title = "joined-trust", "Joined: how far to trust it"
    if not record.frames:
        return ""
    if record.estimate.covariances is None:
        status = html.plot("joined-status", figures.status_figure(record), "Status over time", "", "No pose is known.")
        return html.section(key, title, "", html.paragraph("No pose was found.", "missing"), status)
    found = facts.consistency
    intro = (
        "Tracking is when the camera was believed, coasting when the wheels alone led. Flagged is slip, when the "
        "wheels were not believed; doubtful, when camera and wheels contradicted each other and it was not known which "
        "was right; degenerate, when an image did not show all directions."
    )
    sentence = (
        "The band is ±3σ as the filter stated it. Without a truth, whether that is honest cannot be said."
        if found is None
        else "Estimated minus true position, as the robot sees it, begun at the true start and never fitted again. The "
        "band is ±3σ as the filter stated it; red is where the true position lies beyond it. (Both directions are "
        "judged together, by the 3σ ellipse.)"
    )
    alt = f"{_leading_sentence(facts)} {_consistency_sentence(facts)}".strip()
    plot = html.plot(key, trust_figure(record, found), "Error, stated error, status", sentence, alt)
    return html.section(key, title, intro, plot, sections.matches(record, record.odometry))


def _leading_sentence(facts: JoinedFacts) -> str:
    """Which sensor led."""
    led = "the camera led throughout"
    if facts.coasting_s:
        share = words.percent(facts.share_of(Status.COASTING))
        whole, longest = words.duration(sum(facts.coasting_s)), words.duration(max(facts.coasting_s))
        led = f"it coasted on the wheels {_times(len(facts.coasting_s))}, for {whole} in all ({share} of the time)"
        led += f", {longest} at most" if len(facts.coasting_s) > 1 else ""
    elif not facts.seconds.get(Status.TRACKING):
        led = "it never tracked"
    lost_s = facts.seconds.get(Status.LOST, 0.0)
    led += f", and was lost for {words.duration(lost_s)}" if lost_s else ""
    return f"{led[0].upper()}{led[1:]}."


def _consistency_sentence(facts: JoinedFacts) -> str:
    found = facts.consistency
    if found is None:
        return ""
    return (
        f"Begun at the true start, it ends {words.length(found.drift_m)} off, {words.percent(found.drift_share)} of "
        f"the way; the position is within its stated 3σ in {words.percent(found.share)} of the time."
    )


def _share(share: float) -> str:
    return words.percent(share) if share else "never"


def _times(n: int) -> str:
    return "once" if n == 1 else f"{n} times"
