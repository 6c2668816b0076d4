"""The table: whatever the nets say it can be read backwards, and it says where no data back it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.learn.made_pedals import REST, law, vehicle
from tunefree_hil.control.calibration_map import CalibrationMap, from_triples, load, lookup
from tunefree_hil.learn.open_loop_map.cells import make_cell_edges
from tunefree_hil.learn.open_loop_map.samples import BRAKE, PEDALS, THROTTLE
from tunefree_hil.learn.open_loop_map.table import (
    EXTRAPOLATED,
    INTERPOLATED,
    SUPPORTED,
    MapGrid,
    invert_row,
    is_monotone,
    law_from_calibration,
    make_grid,
    table_from_grid,
    write_table,
)

EDGES = {pedal: make_cell_edges(vehicle(), pedal) for pedal in PEDALS}
TRUE_LAWS = {
    THROTTLE: np.vectorize(lambda speed, command: law(speed, command, REST)),
    BRAKE: np.vectorize(lambda speed, command: law(speed, REST, command)),
}
WIDE = {pedal: np.array([-20.0, 20.0]) for pedal in PEDALS}


def everywhere(pedal: str, upto: int = 12) -> np.ndarray:
    edges = EDGES[pedal]
    there = np.zeros((len(edges.speed_mps) - 1, len(edges.command_frac) - 1), dtype=bool)
    there[:upto] = True
    return there


def grid(laws=TRUE_LAWS, there=None) -> MapGrid:
    return make_grid(laws, there or {pedal: everywhere(pedal) for pedal in PEDALS}, EDGES, WIDE)


def as_map(table) -> CalibrationMap:
    return from_triples(*(column.tolist() for column in table[:3]))


def wavy(seed: int):
    """A law that rises and falls in the command, as a net may where there are no data."""
    rng = np.random.default_rng(seed)
    a, b, c, d = rng.normal(size=4)
    return lambda speed, command: a * np.sin(9.0 * command + b) + 3.0 * c * command + 0.1 * d * speed


@given(st.integers(0, 10_000))
def test_any_two_laws_become_a_map_that_can_be_read_backwards(seed: int) -> None:
    made = grid({THROTTLE: wavy(seed), BRAKE: wavy(seed + 1)})
    assert np.all(np.diff(made.accel_mps2, axis=1) >= -1e-12)
    table = table_from_grid(made)
    assert is_monotone(table)
    own = as_map(table)
    rng = np.random.default_rng(seed)
    for _ in range(20):
        speed, accel, more = rng.uniform(0.0, 12.0), rng.uniform(-4.0, 4.0), rng.uniform(0.0, 2.0)
        low, high = lookup(own, speed, accel), lookup(own, speed, accel + more)
        assert high >= low - 1e-12
        assert -0.5 <= low <= 0.8 and (low >= REST - 1e-12 or low <= 0.8)


@given(st.floats(0.3, 11.0), st.floats(-3.0, 1.5))
def test_what_is_looked_up_gives_that_acceleration(speed: float, accel: float) -> None:
    command = lookup(OWN, speed, accel)
    throttle, brake = max(command, REST), max(-command, REST)
    most = law(speed, 0.8, REST)
    if accel < most - 0.05:
        assert law(speed, throttle, brake) == pytest.approx(accel, abs=0.12)


OWN = as_map(table_from_grid(grid()))


@pytest.mark.parametrize("pedal", PEDALS)
def test_read_forwards_it_is_the_law_again(pedal: str) -> None:
    speeds, commands = np.meshgrid([0.5, 1.7, 4.0, 8.5], np.linspace(REST, 0.42, 12))
    told = law_from_calibration(OWN, pedal)(speeds.ravel(), commands.ravel())
    assert told == pytest.approx(TRUE_LAWS[pedal](speeds.ravel(), commands.ravel()), abs=0.1)


def test_dead_bands_are_stepped_over() -> None:
    """A hair below coasting asks for the brake where it begins to bite, a hair above for the throttle where it does."""
    speed = 5.0
    coast = law(speed, REST, REST)
    assert lookup(OWN, speed, coast - 0.004) == pytest.approx(-0.19, abs=0.007)
    assert lookup(OWN, speed, coast + 0.002) == pytest.approx(0.17, abs=0.012)


def test_a_flat_stretch_keeps_the_smallest_pedal() -> None:
    accels = np.array([-3.0, -2.0, -2.0, -0.2, -0.2, -0.2, 1.0, 2.0, 2.0])
    commands = np.array([-0.4, -0.3, -0.25, -0.2, 0.0, 0.2, 0.3, 0.4, 0.5])
    points = invert_row(accels, commands, np.ones(9), 4, 0.15)
    assert [(round(a, 4), c) for a, c, _ in points] == [
        (-3.0, -0.4), (-2.0, -0.25), (-0.2025, -0.2), (-0.2, 0.2), (1.0, 0.3), (2.0, 0.4)
    ]  # fmt: skip


def test_a_pedal_that_rests_at_zero_and_bites_at_once_has_one_point_for_coasting() -> None:
    points = invert_row(np.array([-1.0, 0.0, 1.0]), np.array([-0.2, 0.0, 0.2]), np.ones(3), 1, 0.0)
    assert [(a, c) for a, c, _ in points] == [(-1.0, -0.2), (0.0, 0.0), (1.0, 0.2)]


def test_support_tells_data_from_gaps_and_what_lies_beyond() -> None:
    there = {pedal: everywhere(pedal) for pedal in PEDALS}
    there[THROTTLE][6, 6:10] = False  # between data at 3 to 4 m/s,
    there[THROTTLE][7, 6:10] = False
    there[BRAKE][6:9, 12:] = False  # and nothing behind these
    made = grid(there=there)
    row = int(np.flatnonzero(made.speed_mps == 4.0)[0])
    throttle = made.support[row, made.rest_column + 1 :]
    assert throttle[4] == SUPPORTED and set(throttle[5:8]) == {INTERPOLATED} and throttle[9] == SUPPORTED
    brake = made.support[row, : made.rest_column][::-1]
    assert brake[10] == SUPPORTED and set(brake[11:]) == {EXTRAPOLATED}
    first = int(np.flatnonzero(made.speed_mps == 1.0)[0])
    assert np.all(made.support[first] == SUPPORTED)


def test_nothing_beyond_the_data_is_promised() -> None:
    seen = {THROTTLE: np.array([-0.3, 1.0]), BRAKE: np.array([-2.0, 0.2])}
    made = make_grid(TRUE_LAWS, {pedal: everywhere(pedal) for pedal in PEDALS}, EDGES, seen)
    assert made.accel_mps2.max() <= 1.0 and made.accel_mps2.min() >= -2.0


def test_the_file_is_what_the_controller_loads(tmp_path: Path) -> None:
    table = table_from_grid(grid())
    path = tmp_path / "deep" / "calibration.npz"
    write_table(path, table, '{"seed": 1}')
    assert [one.name for one in path.parent.iterdir()] == ["calibration.npz"]
    own = load(path)
    for speed, accel in ((0.2, 0.1), (3.3, -1.0), (9.0, 0.4)):
        assert lookup(own, speed, accel) == lookup(as_map(table), speed, accel)
    with np.load(path) as archive:
        assert len(archive["support"]) == len(archive["command_frac"])
        assert str(archive["card"]) == '{"seed": 1}'
