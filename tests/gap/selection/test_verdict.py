"""From steps of a search to a verdict: who has rivals is one of a set, alone or beside others."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest

from tests.gap.estimation.test_intervals import ALL as BLOCKS_OF
from tests.gap.estimation.test_intervals import DELAY, fitted
from tests.gap.selection.test_criteria import spread, weighed
from tunefree_hil.base.contracts import Link
from tunefree_hil.gap.diagnostics.residual_tests import Looked
from tunefree_hil.gap.estimation.nuisance import DRIFT
from tunefree_hil.gap.measured.excitation import Excited
from tunefree_hil.gap.selection.baseline_misfit import NOTHING, Usual
from tunefree_hil.gap.selection.criteria import Weighed
from tunefree_hil.gap.selection.verdict import (
    SET_NATS,
    alike_words,
    daily_words,
    not_it,
    small_words,
    still_words,
    verdict_of,
    wavers,
    with_others,
)

SEEN, UNSEEN = Excited(2.0, True, ()), Excited(0.3, False, ("3 brakings by 3 m/s or more, 9 are needed",))
BARELY = Excited(0.75, False, ("3 brakings by 3 m/s or more, 4 are needed",))
NAMES = ("brake_gain", "brake_fade", "brake_drag", "rolling_resistance", "steer_lag", "steer_dead_time")
DRIVES = cast(Any, [type("Drive", (), {"has": lambda self, *names: True})()])
QUIET = Looked("brake", Link.COMMAND_TO_REPORT, "1", 0.1, 0.1, 0.0, 0.0, False)


FADES = weighed(brake_gain=spread(1.0), brake_fade=spread(1.2), brake_drag=spread(6.0))
ALONE = {one.name: one.evidence for one in FADES}


def step(name: str, *others: str) -> Weighed:
    return weighed(**{name: spread(1.0)})[0]._replace(others=others)


def verdict(
    *steps: Weighed,
    brakes: Excited = SEEN,
    amiss: str = "",
    unsteady: dict[str, float] | None = None,
    placed: dict[str, float] | None = None,
) -> tuple[str, tuple[str, ...], tuple[str, ...]]:
    held = {name: brakes if name == "brake_gain" else SEEN for name in NAMES}
    told = [with_others(one._replace(placed=placed or ALONE), steps, held, DRIVES) for one in steps]
    return verdict_of(list(steps), told, [QUIET], amiss, held, (), unsteady or {})


@pytest.mark.parametrize(
    ("steps", "says", "names"),
    [
        ((step("brake_gain"),), "one", ()),
        ((step("brake_gain", "brake_fade"),), "set", ("brake_gain", "brake_fade")),
        ((step("brake_gain"), step("steer_lag")), "several", ()),
        (
            (step("brake_gain"), step("steer_lag", "steer_dead_time")),
            "set",
            ("brake_gain", "steer_lag", "steer_dead_time"),
        ),
        ((step("brake_drag", "rolling_resistance"),), "one", ()),  # a class is one name
        ((step("brake_gain", "steer_lag"), step("steer_lag")), "several", ()),  # it is there already
        # nor do two of a class stand in a set: the better one does for both
        ((step("brake_gain", "rolling_resistance", "brake_drag"),), "set", ("brake_gain", "brake_drag")),
    ],
)
def test_rivals_make_a_set_of_one_effect_and_of_several(
    steps: tuple[Weighed, ...], says: str, names: tuple[str, ...]
) -> None:
    found = verdict(*steps)
    assert found[:2] == (says, names) and bool(found[2]) == (says == "set")


def test_who_would_look_the_same_is_told_beside_a_name() -> None:
    assert alike_words(["brake_drag", "rolling_resistance"], DRIVES) == (), "both are named"
    none = cast(Any, [type("Drive", (), {"has": lambda self, *names: False})()])
    assert "road_bank" in alike_words(["side_wind"], none)[0]
    assert alike_words(["side_wind"], [*none, *DRIVES]) == (), "one log tells them apart, and that is enough"
    (words,) = alike_words(["steer_lag", "brake_drag"], DRIVES)
    assert words == "brake_drag: no log of this car tells it from rolling_resistance"


def test_faint_rivals_are_no_set_as_no_proof_could_bear_one_out() -> None:
    faint = step("brake_gain", "brake_fade")._replace(unbroken=True, shrink=(0.2, 0.1, 0.3), evidence=SET_NATS - 1.0)
    assert verdict(faint._replace(evidence=SET_NATS + 1.0))[:2] == ("set", ("brake_gain", "brake_fade"))
    assert verdict(faint)[:2] == ("none_missing", ()) and "brake_gain, brake_fade" in verdict(faint)[2][0]
    held = dict.fromkeys(NAMES, SEEN)
    elsewhere = QUIET._replace(signal="steer", explicable=0.05, share=0.5, broken=True)
    says, names, words = verdict_of([faint], [faint], [QUIET, elsewhere], "", held, (), {})
    assert (says, names) == ("none_of_these", ()) and elsewhere.missed in words[0]
    assert verdict(faint, step("steer_lag"))[0] == "set", "one of several is plain"
    alone = verdict(faint._replace(others=()))
    assert alone[0] == "one" and "only a proof" in alone[2][0]


def test_what_the_drive_could_hardly_show_is_a_set_with_whom_it_is_easily_taken_for() -> None:
    says, names, words = verdict(step("brake_gain"), brakes=UNSEEN)
    assert (says, names) == ("set", ("brake_gain", "brake_fade")) and "9 are needed" in words[0]
    says, names, words = verdict(step("brake_gain"), brakes=BARELY)
    assert (says, names) == ("one", ()) and "4 are needed" in words[0]


def test_beside_other_effects_it_is_asked_who_comes_near_in_its_place() -> None:
    """Alone the other effect is in everybody's evidence, and makes all of them near."""
    steps, brakes = (step("brake_gain"), step("steer_lag")), UNSEEN
    assert verdict(*steps, brakes=brakes)[:2] == ("set", ("brake_gain", "brake_fade", "steer_lag"))
    placed = {"brake_gain": 300.0, "brake_fade": 40.0}
    assert verdict(*steps, brakes=brakes, placed=placed)[:2] == ("several", ())


def test_nothing_found_and_nothing_missed_is_nothing_missing() -> None:
    assert verdict()[0] == "none_missing"


def test_a_gain_that_is_another_one_in_each_block_is_no_recalibration() -> None:
    says, _, words = verdict(unsteady={"throttle_gain.gain_frac": 3.2})
    assert says == "none_of_these" and "throttle_gain.gain_frac" in words[0] and "3.2 standard" in words[0]
    assert verdict(step("brake_gain"), unsteady={"throttle_gain.gain_frac": 3.2})[0] == "one"


BROKEN, LOUD = QUIET._replace(broken=True, share=0.1), QUIET._replace(broken=True, loud=0.4)
HUM = BROKEN._replace(loud=0.14)  # moments that no link is broken by
WORKED = {"brake": 0.135}


@pytest.mark.parametrize(
    ("was", "still", "left", "says"),
    [
        (BROKEN, QUIET, 0.6, ""),  # what is left there a calibrated model may miss
        (BROKEN, BROKEN, 0.2, ""),
        (BROKEN, BROKEN, 0.6, "leaves 60% of what could be explained of brake"),
        (LOUD, LOUD._replace(loud=0.3), 0.0, "still brake is missed by 30% of the signal in moments, and hardly else"),
        (LOUD._replace(loud=5.0), LOUD, 0.0, ""),  # the form of what is there is not quite the catalogue's
        (LOUD._replace(loud=1.7), LOUD, 0.0, ""),  # less than a quarter
        (LOUD._replace(loud=1.5), LOUD, 0.0, "still brake is missed by 40% of the signal in moments, and hardly else"),
        (BROKEN._replace(gross=0.9), BROKEN._replace(gross=0.5), 0.2,
         "still brake is missed by 50% of the signal, and little of that is foretold by anything"),
        (BROKEN._replace(gross=2.1), BROKEN._replace(gross=0.5), 0.2, ""),
        (BROKEN, BROKEN._replace(visible=0.12), 0.6, ""),  # as much its own calibration missed
        (BROKEN, HUM._replace(signal="steer", share=0.13), 1.0, ""),
        (BROKEN, HUM._replace(signal="steer", share=0.13, loud=0.9), 1.0,
         "explains less than what is left elsewhere: steer is missed by 90% of the signal in moments, and hardly else"),
        (BROKEN, BROKEN._replace(signal="steer"), 1.0, ""),  # another thing, and a smaller one
        (BROKEN, LOUD._replace(signal="steer"), 1.0,
         "explains less than what is left elsewhere: steer is missed by 40% of the signal in moments, and hardly else"),
    ],
)  # fmt: skip
def test_a_name_is_answerable_for_what_is_left(was: Looked, still: Looked, left: float, says: str) -> None:
    before = [was, *([still] if still.signal != was.signal else [])]
    assert not_it(before, [still], {"brake": left, "steer": 1.0}, WORKED) == says
    found = verdict(step("brake_gain"), amiss=says)
    assert (found[0] == "none_of_these") == bool(says)


@pytest.mark.parametrize(
    ("differ", "moves", "explains", "says"),
    [
        (0.5, 0.2, 0.3, False),
        (30.0, 0.2, 0.3, True),
        (30.0, 0.02, 0.03, False),  # as much a calibrated model may miss
        (30.0, 0.05, 0.3, False),  # a sixth of what it explains
    ],
)
def test_what_is_another_one_in_each_block_is_no_effect(
    differ: float, moves: float, explains: float, says: bool
) -> None:
    one, asked = step("steer_dead_time"), list[tuple[str, float]]()

    def moved(key: str, by: float) -> dict[str, float]:
        asked.append((key, by))
        return {"brake": moves}

    repaired = one.model._replace(fitted=fitted(DELAY, differ=differ))
    said = wavers([one], repaired, BLOCKS_OF, np.zeros(len(BLOCKS_OF)), [QUIET], {"brake": explains}, moved)
    assert bool(said) == says and (not says or said.startswith("what it would be of steer_dead_time differs by"))
    assert [key for key, _ in asked] == ([DELAY.key] if differ > 1.0 else [])


def test_what_is_of_the_day_and_differs_between_drives_is_told() -> None:
    (words,) = daily_words({"grade.grade_rad": 2.3})
    assert words.startswith("grade.grade_rad differs by 2.3 standard deviations between the drives")
    assert daily_words({}) == ()


def test_of_a_name_no_larger_than_a_days_change_that_is_said() -> None:
    by = DRIFT["brake_gain.gain_frac"]
    assert small_words({"brake_gain": {"gain_frac": 1.0 - 1.9 * by}, "steer_lag": {"tau_s": 0.001}}) == (
        "brake_gain: so little of it may come and go from day to day",
    )
    assert small_words({"brake_gain": {"gain_frac": 1.0 + 2.1 * by}}) == ()


def test_only_what_is_missed_beyond_usual_is_quoted_and_the_worst_of_that_first() -> None:
    yaw = Looked("yaw_rate", Link.REPORT_TO_MOTION, "rad/s", 0.2, 0.1, 0.2, 0.35, True, loud=0.25)
    speed = yaw._replace(signal="rate_of_speed", share=0.2, loud=0.39)
    usual = Usual({}, {}, loud={"yaw_rate": 0.2, "rate_of_speed": 0.39}, share={"yaw_rate": 0.02})
    _, _, (words,) = verdict_of([], [], [speed, yaw], "", {}, (), {}, usual)
    assert words == "yaw_rate is missed by 35.0%, and no effect explains it"
    assert still_words([yaw], [], usual)[0].startswith("yaw_rate is missed by 35.0% all the same")
    gross = yaw._replace(gross=0.5)
    said = not_it([gross], [gross], {"yaw_rate": 0.1}, {"yaw_rate": 0.3}, usual)
    assert said.startswith("still yaw_rate is missed by 50% of the signal, and little")


def test_what_is_missed_beside_a_name_is_said() -> None:
    yaw = Looked("yaw_rate", Link.REPORT_TO_MOTION, "rad/s", 0.2, 0.1, 0.2, 0.06, True)
    (words,) = still_words([yaw, QUIET], ["rate_of_speed"])
    assert words.startswith("yaw_rate is missed by 6.0%") and "nothing that is named here" in words
    assert still_words([yaw], ["yaw_rate"]) == (), "who works on it is asked for it"
    assert still_words([yaw], [], NOTHING._replace(own_missed={"yaw_rate": 0.05})) == ()
