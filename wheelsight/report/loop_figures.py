"""The plan of a trajectory that loops have corrected: the way before and after, loops kept and refused."""

from __future__ import annotations

import numpy as np

from wheelsight.geometry import BoolArray, FloatArray, se3
from wheelsight.pipeline import words
from wheelsight.pipeline.run_record import RunRecord
from wheelsight.report import _drawing as drawing
from wheelsight.report import _html as html
from wheelsight.report import _plotly as go
from wheelsight.report import _series as series
from wheelsight.report._drawing import BLUE, GREEN, GREY, ORANGE, VERMILLION
from wheelsight.report.figures import truth_path_m

# More lines than this hide what lies below.
_MOST_DRAWN = 400


def section(record: RunRecord, of: str = "") -> str:
    """The section about loops, of one odometry on a page of several; empty where none were asked for."""
    correction = record.correction
    if correction is None:
        return ""
    ates = [
        words.length(found.ate.translation.rmse)
        for found in (record.evaluation, correction.evaluation)
        if found is not None
    ]
    errors = f" ATE is {ates[0]} as lived and {ates[1]} as known at the end." if len(ates) > 1 else ""
    intro = f"{correction.sentence}.{errors}"
    sentence = (
        "Both ways begin at one pose. A line joins the two views of a match where they lie in the end; one that was "
        "refused joins places apart."
    )
    alt = f"Way before and after {len(correction.found.loops.kept)} loops were closed"
    plot = html.plot(f"loops-plan{of and f'-{of}'}", loops_figure(record), "Before and after", sentence, alt)
    return html.section(f"loops{of and f'-{of}'}", f"Loops{of and f', {of}'}", intro, plot)


def loops_figure(record: RunRecord) -> go.Figure:
    """From above, metres: the way as lived and as known at the end; with an evaluation over the truth.

    Raises:
        ValueError: the run has no loops.
    """
    correction = record.correction
    if correction is None:
        raise ValueError("the run has no loops")
    figure = drawing.style(go.Figure(), 560, hovermode="closest", margin={"l": 58, "r": 12, "t": 34, "b": 46})
    hover = "x %{x:.2f}, y %{y:.2f} m"
    T = np.eye(4) if correction.evaluation is None else correction.evaluation.ate.T_truth_estimate
    paths = {
        "as lived": (se3.apply(T, record.estimate.positions_m), {"color": ORANGE, "width": 1.5}),
        "as known at the end": (se3.apply(T, correction.found.corrected.positions_m), {"color": BLUE, "width": 2}),
    }
    if correction.evaluation is not None:
        paths = {"ground truth": (truth_path_m(record), {"color": GREY, "width": 4}), **paths}
    for name, (positions_m, line) in paths.items():
        path = positions_m[:, :2]
        drawing.add_path(figure, path[series.keep_shape(path)], name=name, line=line, hover=hover)
    keyframes = se3.apply(T, correction.found.T_map_keyframe[:, :3, 3])[:, :2]
    judged = correction.found.loops.judged
    is_kept = np.array([one.is_kept for one in judged], bool)
    ends = keyframes[np.array([(one.loop.first, one.loop.second) for one in judged], np.int64).reshape(-1, 2)]
    for name, which, colour in (("refused", ~is_kept, VERMILLION), ("kept", is_kept, GREEN)):
        _add_loops(figure, f"{name}: {np.count_nonzero(which):,}", ends, which, colour)
    figure.update_xaxes(title_text="x, m")
    figure.update_yaxes(title_text="y, m", scaleanchor="x", scaleratio=1)
    return figure


def _add_loops(figure: go.Figure, name: str, ends: FloatArray, which: BoolArray, colour: str) -> None:
    """Lines (L, 2, 2) between ends, evenly picked where there are too many."""
    drawn = ends[which]
    drawn = drawn[:: max(1, -(-len(drawn) // _MOST_DRAWN))]
    broken = np.concatenate([drawn, np.full((len(drawn), 1, 2), np.nan)], axis=1).reshape(-1, 2)
    figure.add_scatter(
        x=broken[:, 0],
        y=broken[:, 1],
        mode="lines+markers",
        name=name,
        line={"color": colour, "width": 0.7},
        marker={"color": colour, "size": 3},
        hoverinfo="skip",
    )
