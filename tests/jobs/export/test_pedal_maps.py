"""Tables of acceleration by pedal and speed: Autoware's conditions and its rule, on maps as they come."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.jobs.export.read_back import read_csv
from tunefree_hil.control.calibration_map import CalibrationMap, from_triples, lookup
from tunefree_hil.jobs.export.pedal_maps import (
    BRAKE,
    LARGEST_ROWS,
    LEAST_STEP_MPS2,
    THROTTLE,
    find_pedal,
    largest_difference,
    make_pedal_map,
    render_csv,
)

REST = 0.15


def linear_map(tops: tuple[float, ...] = (0.8, 0.8), points: int = 14) -> CalibrationMap:
    """10 m/s2 a duty on the throttle, 20 on the brake, -0.1 m/s2 at rest; `tops`: the last throttle of each speed."""
    triples = []
    for speed, top in enumerate(tops):
        for duty in np.linspace(REST, top, points):
            triples.append((5.0 * speed, 10.0 * (duty - REST) - 0.1, duty))
        for duty in np.linspace(REST, 0.5, points):
            triples.append((5.0 * speed, -20.0 * (duty - REST) - 0.1001, -duty))
    return from_triples(*map(list, zip(*triples, strict=True)))


def test_a_linear_map_is_met_everywhere() -> None:
    calibration = linear_map()
    for sign, slope in ((THROTTLE, 10.0), (BRAKE, -20.0)):
        pedal_map = make_pedal_map(calibration, REST, sign)
        assert max(largest_difference(pedal_map, calibration, REST)) < 5e-4
        for pedal in (0.0, 0.01, 0.123, 0.3):
            assert find_pedal(pedal_map, slope * pedal - 0.1, 3.3) == pytest.approx(pedal, abs=2e-5)
    throttle = make_pedal_map(calibration, REST, THROTTLE)
    assert find_pedal(throttle, 99.0, 3.0) == throttle.pedal_frac[-1] and find_pedal(throttle, -9.0, 3.0) == 0.0


def test_a_speed_whose_commands_end_earlier_keeps_its_last_acceleration() -> None:
    pedal_map = make_pedal_map(linear_map((0.8, 0.4)), REST, THROTTLE)
    last = pedal_map.pedal_frac > 0.25
    short = pedal_map.accel_mps2[last, 1]
    assert short[0] == pytest.approx(2.4, abs=0.01) and np.all(np.diff(short) >= 0.999 * LEAST_STEP_MPS2)
    assert short[-1] < 2.4 + LEAST_STEP_MPS2 * (last.sum() + 1)


def test_many_commands_become_evenly_spaced_rows() -> None:
    calibration = linear_map(points=500)
    pedal_map = make_pedal_map(calibration, REST, THROTTLE)
    assert pedal_map.pedal_frac.size == LARGEST_ROWS and np.ptp(np.diff(pedal_map.pedal_frac)) < 2e-5
    assert largest_difference(pedal_map, calibration, REST).pedal_frac < 1e-4


@given(
    st.lists(
        st.tuples(st.sampled_from([0.0, 2.0, 5.0]), st.floats(-8.0, 4.0), st.floats(0.15, 0.8), st.booleans()),
        min_size=1,
        max_size=30,
    )
)
def test_any_map_gives_tables_that_autoware_takes(points: list[tuple[float, float, float, bool]]) -> None:
    """Measured tables are not monotone; repeated commands and single points occur."""
    calibration = from_triples(
        [one[0] for one in points], [one[1] for one in points], [-one[2] if one[3] else one[2] for one in points]
    )
    for sign in (THROTTLE, BRAKE):
        _, pedals, rows = read_csv(render_csv(make_pedal_map(calibration, REST, sign), "default"))
        assert pedals[0] == 0.0 and np.all(np.diff(pedals) > 0.0)
        assert np.all(sign * np.diff(rows, axis=0) > 0.0)


def test_the_difference_is_that_of_the_tables() -> None:
    """A table that is wrong by 0.02 of duty shows it."""
    calibration = linear_map()
    pedal_map = make_pedal_map(calibration, REST, THROTTLE)
    wrong = pedal_map._replace(accel_mps2=pedal_map.accel_mps2 + 0.2)
    assert largest_difference(wrong, calibration, REST) == pytest.approx((0.02, 0.2), rel=0.1)
    assert lookup(calibration, 0.0, 1.0) == pytest.approx(REST + 0.11)
