"""Surfels as columns of whole numbers: what comes back is what was there, but for the steps that are reported."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from wheelsight.mapping import Surfels
from wheelsight.mapping.columns import columns_of, packed, surfels_of, unpacked

COUNT, STAMP_S, STABLE = 4000, 1.7e9, 10.0


@pytest.fixture
def surfels(rng: np.random.Generator) -> Surfels:
    """Each hangs on a keyframe of its own, by which it is found again."""
    normal = rng.normal(size=(COUNT, 3))
    normal[:18] = np.repeat(np.eye(3), 6, axis=0) * np.tile([1, -1], 9)[:, None] + 0.0
    normal[18:40, rng.integers(3)] = 0
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    color = rng.uniform(0, 255, (COUNT, 3))
    color[rng.random(COUNT) < 0.1] = -1
    last_s = STAMP_S - rng.uniform(0, 100, COUNT)
    return Surfels(
        position=rng.uniform(-50, 50, (COUNT, 3)).astype(np.float32),
        normal=normal.astype(np.float32),
        radius_m=np.exp(rng.uniform(np.log(5e-4), np.log(0.1), COUNT)).astype(np.float32),
        color=color.astype(np.float32),
        grey=rng.uniform(0, 255, COUNT).astype(np.float32),
        confidence=np.concatenate([[9.99, 10, 10.01], rng.uniform(0.4, 100, COUNT - 3)]).astype(np.float32),
        variance_m2=np.exp(rng.uniform(np.log(1e-8), np.log(1e-2), COUNT)).astype(np.float32),
        first_s=last_s - rng.uniform(0, 50, COUNT),
        last_s=last_s,
        keyframe=np.arange(COUNT, dtype=np.int32) - 1,
    )


def there_and_back(surfels: Surfels) -> Surfels:
    return surfels_of(columns_of(surfels, STAMP_S, STABLE), STAMP_S, STABLE)


def test_a_surface_stays_where_it_is_and_surfels_slide_in_it_by_a_quarter_of_their_radius(surfels):
    error = there_and_back(surfels).position.astype(float) - surfels.position
    # 4 µm: a step of float32 at 50 m.
    assert np.abs(np.einsum("ij,ij->i", error, surfels.normal)).max() < 0.25e-3 + 8e-6
    # Steps are of the rounded radius, 2 % larger at most, and 0.5 mm at least; a normal leans against its axis by 55°.
    step = np.maximum(1.03 * surfels.radius_m / 4, 0.5e-3)
    assert (np.linalg.norm(error, axis=1) < step / np.sqrt(2) * np.sqrt(3) + 0.5e-3).all()


def test_other_numbers_come_back_within_their_steps(surfels):
    found = there_and_back(surfels)
    cosine = np.einsum("ij,ij->i", found.normal.astype(float), surfels.normal)
    assert np.degrees(np.arccos(np.minimum(cosine, 1))).max() < 0.96
    np.testing.assert_allclose(np.linalg.norm(found.normal, axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(found.radius_m / surfels.radius_m, 1, atol=0.022)
    np.testing.assert_allclose(np.sqrt(found.variance_m2 / surfels.variance_m2), 1, atol=0.045)
    np.testing.assert_allclose(found.color, surfels.color, atol=0.5)
    np.testing.assert_allclose(found.grey, surfels.grey, atol=0.5)
    np.testing.assert_array_equal(found.color == -1, surfels.color == -1)
    np.testing.assert_array_equal(found.keyframe, surfels.keyframe)
    for name in ("first_s", "last_s"):
        later_s = getattr(found, name) - getattr(surfels, name)
        assert later_s.min() > -1e-4
        assert later_s.max() <= 0.5
    assert (found.first_s <= found.last_s).all()
    assert (found.last_s <= STAMP_S).all()


def test_a_stable_surfel_stays_stable_and_another_does_not_become_it(surfels):
    found = there_and_back(surfels).confidence
    is_stable = surfels.confidence >= STABLE
    np.testing.assert_array_equal(found >= STABLE, is_stable)
    np.testing.assert_allclose(found[is_stable] / surfels.confidence[is_stable], 1, atol=0.1)
    assert found[surfels.confidence == STABLE] == [STABLE]


def test_what_came_back_goes_the_same_way_again(surfels):
    first = columns_of(surfels, STAMP_S, STABLE)
    second = columns_of(surfels_of(first, STAMP_S, STABLE), STAMP_S, STABLE)
    for name, column in first.items():
        np.testing.assert_array_equal(column, second[name], err_msg=name)


def test_columns_do_not_depend_on_the_order_of_surfels(surfels, rng):
    # Many in one place, which differ in grey and colour alone.
    same = replace(surfels, **{name: np.repeat(getattr(surfels, name)[:1], COUNT, axis=0) for name in GEOMETRY})
    for some in (surfels, same):
        order = rng.permutation(COUNT)
        shuffled = Surfels(*(getattr(some, field.name)[order] for field in fields(Surfels)))
        first, second = (columns_of(one, STAMP_S, STABLE) for one in (some, shuffled))
        for name, column in first.items():
            np.testing.assert_array_equal(column, second[name], err_msg=name)


GEOMETRY = ("position", "normal", "radius_m", "keyframe")


@given(
    st.sampled_from(["<i1", "<i2", "<i4"]).flatmap(
        lambda dtype: hnp.arrays(np.dtype(dtype), st.integers(0, 30), elements=hnp.from_dtype(np.dtype(dtype)))
    )
)
def test_any_column_is_unpacked_as_it_was(column):
    np.testing.assert_array_equal(unpacked(packed(column), column.dtype.str), column)


def test_neighbours_that_are_alike_make_small_bytes(rng):
    column = np.cumsum(rng.integers(-60, 61, 1000)).astype("<i4") + 1_000_000
    data = packed(column)
    assert len(data) == 4000
    assert not any(data[1001:2000] + data[2001:3000] + data[3001:])
