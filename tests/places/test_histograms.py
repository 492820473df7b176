"""Histograms: numpy's, whatever the image; their settings; and what no image is."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from odometry.plain_kernels import plain
from places.made import frame_of
from pydantic import ValidationError

from wheelsight.core.errors import PlaceError
from wheelsight.core.messages import RgbdFrame
from wheelsight.places import HistogramDescriber, HistogramSettings, describer_from
from wheelsight.places import describer_kernels as compiled

COUNTS = HistogramSettings(scale="counts", missing="own_bin", step_px=1)


def grey_of(color: np.ndarray) -> np.ndarray:
    return (color.astype(int) @ np.array([77, 150, 29])) >> 8


def counted(frame: RgbdFrame, s: HistogramSettings) -> np.ndarray:
    """Grey, depth and missing counts by numpy.histogram."""
    every = slice(None, None, s.step_px)
    grey, depth_m = grey_of(frame.color[every, every]), frame.depth_m[every, every].astype(float)
    measured = np.isfinite(depth_m) & (depth_m > 0)
    inside = np.clip(depth_m[measured], s.near_m, s.far_m)
    of_grey = np.histogram(grey, s.bins, (0, 256))[0]
    of_depth = np.histogram(inside, s.bins, (s.near_m, s.far_m))[0]
    return np.concatenate([of_grey, of_depth, [np.count_nonzero(~measured)]])


@st.composite
def frames(draw) -> RgbdFrame:
    """Any size; depths at the middles of bins, beyond both ends, missing, and not finite."""
    height, width = draw(st.tuples(st.integers(1, 23), st.integers(1, 23)))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    kind = draw(st.sampled_from(["color", "black", "white"]))
    color = {
        "color": rng.integers(0, 256, (height, width, 3)),
        "black": np.zeros((height, width, 3)),
        "white": np.full((height, width, 3), 255),
    }[kind].astype(np.uint8)
    # Middles of bins of 8 m / 100: at borders, rounding decides.
    depth_m = (rng.integers(-3, 130, (height, width)) + rng.uniform(0.1, 0.9, (height, width))) * 0.08
    odd = np.array([0.0, -1.0, np.nan, np.inf, -np.inf, 1e-30, 3e38])
    places = rng.random((height, width)) < draw(st.sampled_from([0.0, 0.3, 1.0]))
    depth_m[places] = rng.choice(odd, int(places.sum()))
    return RgbdFrame(0.0, color, depth_m.astype(np.float32))


@settings(max_examples=60)
@given(frames(), st.sampled_from([1, 2, 5]))
def test_counts_are_those_of_numpy(frame, step_px):
    s = COUNTS.model_copy(update={"step_px": step_px})
    np.testing.assert_array_equal(HistogramDescriber(s).describe(frame), counted(frame, s))


def test_compiled_counts_as_plain_python_does(rng):
    frame, lut = frame_of(1, rng), np.arange(256) * 20 // 256
    tables = []
    for count_frame in (compiled.count_frame, plain(compiled).count_frame):
        grey, depth = np.zeros(20, np.int64), np.zeros(21, np.int64)
        count_frame(frame.color.astype(np.int64), frame.depth_m, 2, lut, 0.3, 5.0, grey, depth)
        tables.append((grey, depth))
    np.testing.assert_array_equal(tables[0][0], tables[1][0])
    np.testing.assert_array_equal(tables[0][1], tables[1][1])


def test_colour_and_depth_images_may_differ_in_size(rng):
    frame = RgbdFrame(0.0, rng.integers(0, 256, (9, 16, 3), dtype=np.uint8), np.full((5, 4), 2.0, np.float32))
    np.testing.assert_array_equal(HistogramDescriber(COUNTS).describe(frame), counted(frame, COUNTS))


def test_images_need_not_lie_in_one_piece_of_memory(rng):
    frame = frame_of(0, rng)
    mirrored = RgbdFrame(0.0, frame.color[:, ::-1, ::-1], frame.depth_m[::-1])
    np.testing.assert_array_equal(HistogramDescriber(COUNTS).describe(mirrored), counted(mirrored, COUNTS))


def test_the_default_is_two_hundred_shares(rng):
    describer = HistogramDescriber()
    reported = describer.describe(frame_of(0, rng, size=(48, 64)))
    assert reported.shape == (200,) == (describer.size,) == (len(describer.names),)
    assert reported.dtype == np.float32
    np.testing.assert_allclose([reported[:100].sum(), reported[100:].sum()], 1, rtol=1e-5)


@pytest.mark.parametrize("missing", ["first_bin", "own_bin", "ignored"])
def test_missing_depth_counts_where_it_is_reported_to(missing):
    depth_m = np.full((10, 10), 4.0, np.float32)
    depth_m[:3] = 0
    frame = RgbdFrame(0.0, np.zeros((10, 10, 3), np.uint8), depth_m)
    describer = HistogramDescriber(HistogramSettings(bins=4, missing=missing, step_px=1))
    reported = dict(zip(describer.names, describer.describe(frame), strict=True))
    wanted = {"first_bin": (0.3, 0.7), "own_bin": (0.0, 0.7), "ignored": (0.0, 1.0)}[missing]
    np.testing.assert_allclose((reported["depth 0"], reported["depth 2"]), wanted, rtol=1e-6)
    assert reported.get("depth missing") == (pytest.approx(0.3) if missing == "own_bin" else None)
    assert describer.size == len(reported)


def test_no_depth_at_all_is_no_division_by_zero():
    frame = RgbdFrame(0.0, np.zeros((4, 4, 3), np.uint8), np.zeros((4, 4), np.float32))
    reported = HistogramDescriber(HistogramSettings(bins=4, missing="ignored")).describe(frame)
    np.testing.assert_array_equal(reported, [1, 0, 0, 0, 0, 0, 0, 0])


def test_cumulative_shares_end_at_one(rng):
    frame = frame_of(2, rng)
    plain_shares = HistogramDescriber(HistogramSettings(bins=8)).describe(frame)
    summed = HistogramDescriber(HistogramSettings(bins=8, scale="cumulative")).describe(frame)
    np.testing.assert_allclose(summed[:8], np.cumsum(plain_shares[:8]), rtol=1e-6)
    np.testing.assert_allclose(summed[[7, 15]], 1, rtol=1e-6)


@pytest.mark.parametrize("s", [HistogramSettings(), HistogramSettings(bins=7, missing="own_bin", far_m=3.5)])
def test_settings_make_the_describer_again(rng, s):
    frame, describer = frame_of(1, rng), HistogramDescriber(s)
    again = describer_from(describer.settings)
    np.testing.assert_array_equal(again.describe(frame), describer.describe(frame))
    assert again.settings == describer.settings


@pytest.mark.parametrize(
    "wrong", [{"bins": 1}, {"bins": 300}, {"near_m": 5.0, "far_m": 4.0}, {"missing": "lost"}, {"step": 2}]
)
def test_impossible_settings_are_refused(wrong):
    with pytest.raises(ValidationError):
        HistogramSettings(**wrong)
    with pytest.raises(PlaceError, match="description setting"):
        describer_from({"kind": "histograms", **wrong})


def test_an_unknown_description_is_refused():
    with pytest.raises(PlaceError, match=r"no description is called 'ferns' \(known: histograms, layout\)"):
        describer_from({"kind": "ferns"})


@pytest.mark.parametrize(
    ("color", "depth_m"),
    [
        (np.zeros((4, 4), np.uint8), np.zeros((4, 4), np.float32)),
        (np.zeros((4, 4, 4), np.uint8), np.zeros((4, 4), np.float32)),
        (np.zeros((4, 4, 3)), np.zeros((4, 4), np.float32)),
        (np.zeros((0, 4, 3), np.uint8), np.zeros((4, 4), np.float32)),
        (np.zeros((4, 4, 3), np.uint8), np.zeros((4, 4), np.uint16)),
        (np.zeros((4, 4, 3), np.uint8), np.zeros((0, 0), np.float32)),
        (np.zeros((4, 4, 3), np.uint8), np.zeros((4, 4, 1), np.float32)),
    ],
)
@pytest.mark.parametrize("kind", ["histograms", "layout"])
def test_images_that_no_frame_has_are_refused_by_frame(kind, color, depth_m):
    with pytest.raises(PlaceError, match=r"frame 7 at 1\.500 s: (colour|depth) is"):
        describer_from({"kind": kind}).describe(RgbdFrame(1.5, color, depth_m, 7))
