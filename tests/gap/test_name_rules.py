"""From steps of a search to a verdict: who has rivals is one of a set, alone or beside others."""

from __future__ import annotations

from typing import Any, cast

import pytest

from tests.gap.test_decide import spread, weighed
from tunefree_hil.base.contracts import Link
from tunefree_hil.gap.decide import Weighed
from tunefree_hil.gap.excitation import Excited
from tunefree_hil.gap.locate import Looked
from tunefree_hil.gap.name import _verdict, _with_others
from tunefree_hil.gap.suspects import Suspect

SEEN, UNSEEN = Excited(2.0, True, ()), Excited(0.3, False, ("3 brakings by 3 m/s or more, 9 are needed",))
BARELY = Excited(0.75, False, ("3 brakings by 3 m/s or more, 4 are needed",))
NAMES = ("brake_gain", "brake_fade", "brake_drag", "rolling_resistance", "steer_lag", "steer_dead_time")
QUESTION = cast(Any, type("Asked", (), {"suspects": tuple(Suspect(name, (), ()) for name in NAMES)})())
DRIVES = cast(Any, [type("Drive", (), {"has": lambda self, *names: True})()])
QUIET = Looked("brake", Link.COMMAND_TO_REPORT, "1", 0.1, 0.1, 0.0, 0.0, False)


def step(name: str, *others: str) -> Weighed:
    return weighed(**{name: spread(1.0)})[0]._replace(others=others)


def verdict(*steps: Weighed, brakes: Excited = SEEN) -> tuple[str, tuple[str, ...], tuple[str, ...]]:
    held = {name: brakes if name == "brake_gain" else SEEN for name in NAMES}
    told = [_with_others(one, steps, held, QUESTION, DRIVES) for one in steps]
    return _verdict(list(steps), told, [QUIET], [QUIET], 0.1, held, ())


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
    ],
)
def test_rivals_make_a_set_of_one_effect_and_of_several(
    steps: tuple[Weighed, ...], says: str, names: tuple[str, ...]
) -> None:
    found = verdict(*steps)
    assert found[:2] == (says, names) and bool(found[2]) == (says == "set")


def test_what_the_drive_could_hardly_show_is_a_set_with_whom_it_is_easily_taken_for() -> None:
    says, names, words = verdict(step("brake_gain"), brakes=UNSEEN)
    assert (says, names) == ("set", ("brake_gain", "brake_fade")) and "9 are needed" in words[0]
    says, names, words = verdict(step("brake_gain"), brakes=BARELY)
    assert (says, names) == ("one", ()) and "4 are needed" in words[0]


def test_nothing_found_and_nothing_missed_is_nothing_missing() -> None:
    assert verdict()[0] == "none_missing"
