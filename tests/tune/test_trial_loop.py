"""Generations: the parameters of a slot depend on the settings and the generations before it, and on nothing else."""

from __future__ import annotations

from collections.abc import Mapping

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.tune.drive_study import FIRST, SPACE, bowl, settings
from tests.tune.sampler_cases import CASES
from tunefree_hil.tune.trial import Evaluation, Trial, find_best_trial
from tunefree_hil.tune.trial_loop import find_next_slots, suggest_slots

SIZE = 4


def filled(points: Mapping[int, dict[str, float]]) -> list[Trial]:
    return [Trial(slot, slot, values, bowl(values).score, {}) for slot, values in points.items()]


def course(sampler: str, trials: int) -> list[Trial]:
    asked = settings(sampler)._replace(in_flight=SIZE)
    done: list[Trial] = []
    while slots := find_next_slots({trial.slot for trial in done}, SIZE, trials):
        done += filled(suggest_slots(asked, done, slots))
    return done


@pytest.mark.parametrize("sampler", CASES)
def test_a_slot_is_the_same_whatever_of_its_generation_is_missing(sampler: str) -> None:
    whole = course(sampler, 16)
    asked = settings(sampler)._replace(in_flight=SIZE)
    for slots in ([12], [15], [13, 14], [12, 13, 14, 15]):
        others = [trial for trial in whole if trial.slot not in slots]
        again = suggest_slots(asked, others, slots)
        assert again == {slot: whole[slot].parameters for slot in slots}
    assert whole[0].parameters == FIRST


def test_a_study_cut_short_and_made_longer_is_the_same() -> None:
    asked = settings("tpe_independent")._replace(in_flight=SIZE)
    whole = course("tpe_independent", 16)
    begun = course("tpe_independent", 13)
    assert begun == whole[:13]
    assert suggest_slots(asked, begun, find_next_slots(set(range(13)), SIZE, 16)) == {
        k: whole[k].parameters for k in (13, 14, 15)
    }


def test_slots_in_flight_keep_apart() -> None:
    points = [trial.parameters for trial in course("tpe_independent", 16)]
    assert len({tuple(values.values()) for values in points}) == 16
    assert all(SPACE.clip(values) == values for values in points)


def test_generations_learn() -> None:
    """Better than chance from the same start: the scores of the last generations against those of random search."""
    tuned, chance = (course(sampler, 40)[20:] for sampler in ("tpe_independent", "random"))
    assert sum(trial.score for trial in tuned) < sum(trial.score for trial in chance)


@given(st.sets(st.integers(0, 30)), st.integers(1, 9), st.integers(0, 30))
def test_the_next_slots_lie_in_the_first_generation_with_a_gap(filled: set[int], size: int, trials: int) -> None:
    slots = find_next_slots(filled, size, trials)
    missing = [slot for slot in range(trials) if slot not in filled]
    assert bool(slots) == bool(missing)
    if slots:
        assert slots[0] == missing[0]
        assert slots == [slot for slot in missing if slot // size == slots[0] // size]


def test_the_earliest_of_equals_is_the_best() -> None:
    trials = [Trial(2, 0, {}, 0.5, {}), Trial(1, 1, {}, 0.5, {}), Trial(0, 2, {}, 0.7, {})]
    assert find_best_trial(trials) == trials[1] and find_best_trial([]) is None
    assert isinstance(bowl(FIRST), Evaluation)


@pytest.mark.parametrize("size", [1, 2, 3, 8])
def test_further_starts_are_the_slots_after_the_first(size: int) -> None:
    starts = [SPACE.clip({name: factor * value for name, value in FIRST.items()}) for factor in (0.5, 2.0, 0.8)]
    asked = settings("tpe_independent")._replace(in_flight=size, starts=starts)
    done: list[Trial] = []
    while slots := find_next_slots({trial.slot for trial in done}, size, 8):
        done += filled(suggest_slots(asked, done, slots))
    assert [trial.parameters for trial in done[:4]] == [FIRST, *starts]
    assert len({tuple(trial.parameters.values()) for trial in done}) == 8
