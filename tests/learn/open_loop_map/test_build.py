"""From drives of a known car to its map: as good as the car's own law, the same for the same seed."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import numpy as np
import pytest

from tests.learn.made_pedals import DEAD_S, LAG_S, REST, law, pedal_drive, some_drive, vehicle
from tunefree_hil.base.errors import InputError
from tunefree_hil.control.calibration_map import from_triples
from tunefree_hil.learn.compiled_process import exhaust
from tunefree_hil.learn.open_loop_map.build import (
    GatheredSamples,
    LearnedMap,
    gather_samples,
    learn_map,
    select_points,
)
from tunefree_hil.learn.open_loop_map.cells import make_cell_edges
from tunefree_hil.learn.open_loop_map.samples import BRAKE, PEDALS, THROTTLE
from tunefree_hil.learn.open_loop_map.table import SUPPORTED, is_monotone, law_from_calibration
from tunefree_hil.learn.training import map_nets

TRUE_LAWS = {
    THROTTLE: np.vectorize(lambda speed, command: law(speed, command, REST)),
    BRAKE: np.vectorize(lambda speed, command: law(speed, REST, command)),
}


@cache
def gathered() -> GatheredSamples:
    return gather_samples([some_drive(), pedal_drive(240.0, 1, name="other.log")], vehicle())


@pytest.fixture(scope="module")
def small() -> Iterator[None]:
    """One width of two seeds: what is tested does not depend on how many there are."""
    pytest.importorskip("torch", reason="the extra `learn` is not installed")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(map_nets, "HIDDEN_WIDTHS", (8,))
        patch.setattr(map_nets, "N_SEEDS", 2)
        patch.setattr(map_nets, "MAX_ROUNDS", 15)
        yield


@pytest.fixture(scope="module")
def learned(small: None) -> LearnedMap:
    return exhaust(learn_map(gathered().samples, vehicle(), 1))


def test_what_the_drives_say_is_said() -> None:
    found = gathered()
    for pedal in PEDALS:
        assert found.delays[pedal].seconds == pytest.approx(DEAD_S + 0.85 * LAG_S, abs=0.04)
    assert any("straight, level and usable" in words for words in found.notes)
    assert sum("from command to acceleration" in words for words in found.notes) == 2


@pytest.mark.slow
def test_the_map_is_the_cars_own_law_where_there_are_data(learned: LearnedMap) -> None:
    own = learned
    assert is_monotone(own.table)
    table = from_triples(*(column.tolist() for column in own.table[:3]))
    for pedal in PEDALS:
        choice = own.selections[pedal]
        assert choice.is_complete and choice.held_out_mps2 < 0.12
        speed, command = choice.points.speed_mps, choice.points.command_frac
        errors = law_from_calibration(table, pedal)(speed, command) - TRUE_LAWS[pedal](speed, command)
        assert np.sqrt(np.mean(errors * errors)) < 0.06, pedal
    assert np.mean(own.grid.support == SUPPORTED) > 0.3
    assert own.table.command_frac.min() >= -0.36 and own.table.command_frac.max() <= 0.75


@pytest.mark.slow
def test_the_same_seed_gives_the_same_table(learned: LearnedMap) -> None:
    again = exhaust(learn_map(gathered().samples, vehicle(), 1))
    assert all(np.array_equal(one, other) for one, other in zip(learned.table, again.table, strict=True))


def test_one_speed_only_is_said() -> None:
    samples = gathered().samples
    slow = np.abs(samples.speed_mps - 5.5) < 0.4
    edges = {pedal: make_cell_edges(vehicle(), pedal) for pedal in PEDALS}
    with pytest.raises(InputError, match="at 1 speeds") as caught:
        select_points(type(samples)(*(column[slow] for column in samples)), edges, 1)
    assert caught.value.code == "one_speed_only"
