"""Coverage cells: counts are what brute force finds, bands scale with the folder, what is left out says why."""

from __future__ import annotations

import math
from itertools import groupby

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests import other_vehicle
from tunefree_hil.base.records import GEAR_DRIVE, GEAR_NEUTRAL, GEAR_REVERSE
from tunefree_hil.collect.cells import (
    CELL_COUNT,
    MIN_RUN_FRAMES,
    NO_CELL,
    PEDAL_BANDS,
    STEER_BANDS,
    CellCounter,
    CellIndex,
    CellSignals,
    bands_from_envelope,
    cell_index,
    cell_number,
    classify_cell,
    make_target_cells,
)
from tunefree_hil.collect.envelope import Envelope, area_side_for_speed_m, envelope_from_vehicle
from tunefree_hil.collect.features import count_recording
from tunefree_hil.config.load import load_vehicle

MKZ = envelope_from_vehicle(load_vehicle("mkz_bywire"))
VAN = envelope_from_vehicle(load_vehicle(other_vehicle.NAME))
BANDS = bands_from_envelope(MKZ)
FEW = st.lists(st.tuples(st.integers(-1, 3), st.integers(1, 45)), max_size=25)


def drawn(envelope: Envelope) -> st.SearchStrategy[CellSignals]:
    """Ticks of a vehicle, standstill, coasting and unheard values among them."""
    gears = st.sampled_from([GEAR_DRIVE, GEAR_REVERSE, GEAR_NEUTRAL, math.nan])
    steer = st.floats(-envelope.steer_rad, envelope.steer_rad)
    pedal = st.floats(envelope.rest_frac, envelope.throttle_frac)
    brake = st.one_of(st.just(envelope.rest_frac), st.floats(envelope.rest_frac, envelope.brake_frac))
    speed = st.one_of(st.just(math.nan), st.floats(0.0, envelope.speed_mps))
    return st.builds(CellSignals, gears, speed, steer, pedal, brake)


def by_hand(seen: CellSignals) -> int:
    """The MKZ's cell by docs/reference/apollo.md: 10 and 20 m/s; 1, 30, 60 %; 25 and 30, 20 and 25 % duty."""
    if math.isnan(seen.speed_mps) or seen.speed_mps < 0.2 or seen.gear == GEAR_NEUTRAL:
        return NO_CELL
    brake, throttle = 100.0 * seen.brake_frac, 100.0 * seen.throttle_frac
    if brake >= 15.35:
        pedal = "brake light" if brake < 20.005 else "brake mid" if brake < 25.01 else "brake high"
    elif throttle >= 15.65:
        pedal = "throttle light" if throttle < 25.01 else "throttle mid" if throttle < 30.015 else "throttle high"
    else:
        return NO_CELL
    percent = 100.0 * abs(seen.steer_rad) / 8.20305
    side = "left" if seen.steer_rad > 0.0 else "right"
    word = "branch" if percent < 30.0 else "turn" if percent < 60.0 else "sharp"
    steer = STEER_BANDS.index("straight" if percent < 1.0 else f"{word} {side}")
    if seen.gear == GEAR_REVERSE:
        return cell_number(CellIndex(True, steer, 0, PEDAL_BANDS.index(pedal))) if seen.speed_mps < 2.0 else NO_CELL
    return cell_number(
        CellIndex(False, steer, int(seen.speed_mps >= 10.0) + int(seen.speed_mps >= 20.0), PEDAL_BANDS.index(pedal))
    )


@given(drawn(MKZ))
def test_a_tick_is_in_the_cell_of_the_published_table(seen: CellSignals) -> None:
    assert classify_cell(BANDS, seen) == by_hand(seen)


def test_numbers_and_places_are_each_others_inverse() -> None:
    assert [cell_number(cell_index(number)) for number in range(CELL_COUNT)] == list(range(CELL_COUNT))
    assert CELL_COUNT == 102 + 24 + 42  # the source's 144, and 24 of turning faster than any car can


@given(FEW)
def test_only_long_runs_count_and_then_whole(runs: list[tuple[int, int]]) -> None:
    cells = [cell for cell, length in runs for _ in range(length)]
    counter = CellCounter([60] * 4)
    for cell in cells:
        counter.count_frame(cell)
    lengths = [(cell, len(list(run))) for cell, run in groupby(cells)]
    expected = [sum(n for cell, n in lengths if cell == one and n >= MIN_RUN_FRAMES) for one in range(4)]
    assert counter.have == expected
    assert counter.missing == sum(have < 60 for have in expected)


@given(st.lists(st.tuples(drawn(MKZ), st.integers(1, 40)), min_size=1, max_size=12))
def test_a_recording_counts_as_its_ticks_do(runs: list[tuple[CellSignals, int]]) -> None:
    ticks = [seen for seen, length in runs for _ in range(length)]
    one, whole = CellCounter([100] * CELL_COUNT), CellCounter([100] * CELL_COUNT)
    for seen in ticks:
        one.count_frame(by_hand(seen))
    names = ("report.gear", "report.speed_mps", "report.steer_rad", "report.throttle_frac", "report.brake_frac")
    fields: dict[str, np.ndarray] = dict(zip(names, np.array(ticks, dtype=float).T, strict=True))
    count_recording(fields.get, BANDS, whole)
    assert whole.have == one.have


def test_two_recordings_make_no_run_together_and_a_missing_report_is_stood_in_for() -> None:
    half = MIN_RUN_FRAMES - 1
    fields = {
        "ins.speed_mps": np.full(half, 5.0),
        "command.steer_rad": np.zeros(half),
        "report.throttle_command_frac": np.full(half, 0.2),
        "command.brake_frac": np.full(half, 0.15),
    }
    counter = CellCounter([100] * CELL_COUNT)
    count_recording(fields.get, BANDS, count_recording(fields.get, BANDS, counter))
    assert sum(counter.have) == 0
    longer = {name: np.append(values, values[0]) for name, values in fields.items()}
    assert sum(count_recording(longer.get, BANDS, counter).have) == MIN_RUN_FRAMES
    del longer["ins.speed_mps"]
    assert sum(count_recording(longer.get, BANDS, counter).have) == MIN_RUN_FRAMES


@pytest.mark.parametrize("envelope", [MKZ, VAN])
def test_what_is_left_out_says_why_and_what_is_asked_for_can_be_driven(envelope: Envelope) -> None:
    targets = make_target_cells(envelope)
    assert [cell_number(one.index) for one in targets] == list(range(CELL_COUNT))
    for one in targets:
        turn = abs(one.index.steer - 3)
        if one.index.backwards:
            assert "reverse" in one.excluded
        elif turn >= 2 and one.index.speed >= 1:
            assert "lateral" in one.excluded
        else:
            assert not one.excluded and one.low_mps < one.high_mps <= 0.95 * envelope.speed_mps
    assert sum(not one.excluded for one in targets) == 78


def test_backwards_is_asked_for_where_the_folder_says_so_and_fast_cells_are_not_above_the_top() -> None:
    targets = make_target_cells(MKZ, 12.0, reverse_mps=1.5)
    assert sum(one.index.backwards and not one.excluded for one in targets) == 42
    fast = [one for one in targets if one.index.speed == 2 and not one.index.backwards]
    assert fast and all("speed is 12 m/s" in one.excluded for one in fast)
    assert all(one.high_mps <= 12.0 for one in targets if not one.excluded)


def test_a_faster_band_needs_more_ground() -> None:
    sides = [area_side_for_speed_m(MKZ, speed) for speed in (3.0, 10.5, 21.0, 30.0)]
    assert sides == sorted(sides) and sides[2] < 400.0 < sides[3]
    assert area_side_for_speed_m(VAN, 1.05 * 16.5) < 400.0
