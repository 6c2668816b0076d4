"""Cells: strangers are dropped, none weighs more than another, and a held-out cell is held out as a whole."""

from __future__ import annotations

import numpy as np
import pytest

from tests.learn.made_pedals import REST, vehicle
from tunefree_hil.learn.open_loop_map.cells import (
    CELLS,
    assign_cells,
    average_cells,
    compute_cell_errors,
    compute_rms,
    find_populated_cells,
    make_cell_edges,
    split_holdout,
)
from tunefree_hil.learn.open_loop_map.samples import PEDALS, THROTTLE, MapSamples


def some(count: int, speed: float, command: float, accel: float, seed: int = 0) -> np.ndarray:
    noise = np.random.default_rng(seed).standard_normal(count)
    return np.stack(
        [np.full(count, speed), np.full(count, command), accel + 0.02 * noise, np.ones(count), np.ones(count)]
    )


def samples(*parts: np.ndarray) -> MapSamples:
    return MapSamples(*np.concatenate(parts, axis=1))


def test_edges_begin_with_rest_and_end_at_the_limit() -> None:
    for pedal, limit in zip(PEDALS, (0.8, 0.5), strict=True):
        commands = make_cell_edges(vehicle(), pedal).command_frac
        assert np.all(np.diff(commands) > 0.0)
        assert commands[0] < REST < commands[1] and commands[-1] == pytest.approx(limit)
        assert np.diff(commands)[2] < np.diff(commands)[-2]


def test_outliers_thin_cells_and_excess_are_dropped_and_cells_weigh_the_same() -> None:
    edges = make_cell_edges(vehicle(), THROTTLE)
    wild = some(3, 5.5, 0.3, 9.0)
    thin = some(CELLS.min_samples - 1, 11.0, 0.3, 1.0)
    points = assign_cells(
        samples(some(400, 5.5, 0.3, 1.0), wild, thin, some(8, 5.5, 0.4, 1.4)), edges, np.random.default_rng(1)
    )
    means = average_cells(points)
    assert len(means.cell) == 2
    assert means.accel_mps2 == pytest.approx([1.0, 1.4], abs=0.03)
    assert np.sum(points.weight[points.cell == means.cell[0]]) == pytest.approx(1.0)
    assert np.sum(points.cell == means.cell[0]) == CELLS.max_samples
    assert np.sum(points.weight) == pytest.approx(2.0)
    there = find_populated_cells(points, edges)
    assert there.sum() == 2 and there[8].sum() == 2


def test_of_a_cell_with_held_pedals_only_those_count() -> None:
    edges = make_cell_edges(vehicle(), THROTTLE)
    blurred = some(30, 5.5, 0.3, 1.15)
    blurred[-1] = 0.0
    alone = some(30, 11.0, 0.3, 2.0)
    alone[-1] = 0.0
    points = assign_cells(samples(some(8, 5.5, 0.3, 1.0), blurred, alone), edges, np.random.default_rng(1))
    assert average_cells(points).accel_mps2 == pytest.approx([1.0, 2.0], abs=0.03)


def test_cells_are_held_out_as_a_whole_each_once() -> None:
    edges = make_cell_edges(vehicle(), THROTTLE)
    parts = [some(10, speed, command, 1.0) for speed in (1.2, 3.5, 5.5, 11.0) for command in (0.2, 0.3, 0.5)]
    points = assign_cells(samples(*parts), edges, np.random.default_rng(1))
    seen: list[int] = []
    for part in range(5):
        rest, out = split_holdout(points, 5, part, np.random.default_rng(3))
        assert not set(rest.cell) & set(out.cell)
        assert len(rest.cell) + len(out.cell) == len(points.cell)
        seen += sorted(set(out.cell))
    assert sorted(seen) == sorted(set(points.cell))


def test_errors_are_of_cells_not_of_samples() -> None:
    edges = make_cell_edges(vehicle(), THROTTLE)
    points = assign_cells(samples(some(24, 5.5, 0.3, 1.0), some(6, 5.5, 0.5, 2.0)), edges, np.random.default_rng(1))
    errors = compute_cell_errors(lambda speed, command: np.ones_like(speed), points)
    assert errors == pytest.approx([0.0, -1.0], abs=0.03)
    assert compute_rms(errors) == pytest.approx(np.sqrt(0.5), abs=0.03)
    assert np.isnan(compute_rms(np.zeros(0)))
