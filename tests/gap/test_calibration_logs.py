"""What own logs make of an effect: nothing where they do not tell it, and of a limit that it lies beyond them."""

from __future__ import annotations

from collections.abc import Generator
from types import SimpleNamespace
from typing import Any, NamedTuple, cast

import pytest
from msgspec.structs import replace

from tests.gap.estimation.test_intervals import ALL, DELAY, fitted
from tests.gap.made_answer import VEHICLE, made_model
from tests.gap.selection.test_criteria import spread, weighed
from tunefree_hil.config.schema import EffectSpec
from tunefree_hil.gap import calibration_logs
from tunefree_hil.gap.calibration_logs import known_of
from tunefree_hil.gap.estimation.intervals import across
from tunefree_hil.gap.estimation.least_squares import Free
from tunefree_hil.gap.selection.baseline_misfit import Usual, parted
from tunefree_hil.gap.selection.criteria import Weighed
from tunefree_hil.gap.workers.worker import Modelled

LIMIT = Free("steer_rate_limit.rate_radps", 0.1, 20.0, True, float("inf"), -0.35, 1.35)
STEP = weighed(steer_rate_limit=spread(1.0))[0]


def model(free: Free, curve: float, z: float) -> Modelled:
    return Modelled(fitted(free, curve=curve, z=z), {})


@pytest.mark.parametrize("z", [0.2, 0.0])
def test_what_is_told_is_known_as_well_as_the_fit_knows_it_be_it_nothing(z: float) -> None:
    told = model(DELAY, 400.0, z)
    assert known_of("steer_dead_time", told, ALL) == across(told.fitted, ALL)


def test_what_is_not_told_is_not_known() -> None:
    assert known_of("steer_dead_time", model(DELAY, 0.0, 0.2), ALL) == {}


@pytest.mark.parametrize(("z", "news"), [(0.35, True), (0.75, False)])
def test_a_limit_below_all_that_the_own_logs_reached_came_later(z: float, news: bool) -> None:
    beyond = model(LIMIT, 0.0, 0.75)
    (limit,) = known_of("steer_rate_limit", beyond, ALL).items()
    assert limit == ("steer_rate_limit.rate_radps", (pytest.approx(LIMIT.value(0.75)), 0.0))
    usual = Usual({STEP.target: 0.5}, {"steer_rate_limit": {"rate_radps": limit[1]}}, frozenset({STEP.target}))
    found, words = parted([STEP], fitted(LIMIT, z=z), usual, ALL)
    assert bool(found) == news and bool(words) != news


@pytest.mark.parametrize(
    ("target", "evidence", "has", "told"),
    [("yaw_rate", 900.0, False, True), ("yaw_rate", 50.0, False, False), ("rate_of_speed", 900.0, False, False),
     ("yaw_rate", 900.0, True, False)],
)  # fmt: skip
def test_tyres_are_told_where_the_model_comes_near_its_logs_and_plainly(
    target: str, evidence: float, has: bool, told: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is missed of the rate of speed is missed whatever the tyres are: who explains a part of that is nobody."""
    free = Free("tyre_relaxation.length_m", 0.05, 2.0, True, 0.0, -0.35, 1.35)
    found = weighed(tyre_relaxation=spread(1.0))[0]
    found = found._replace(model=model(free, 1e4, free.place(0.3)), evidence=evidence)

    def looked(*_: Any) -> tuple[Any, list[Any]]:
        return None, [SimpleNamespace(signal="rate_of_speed", broken=True)]

    def searched(_: Any, question: Any, names: list[str], *__: Any) -> list[Weighed]:
        return [found._replace(unbroken=target not in question.broken)] if names else []

    monkeypatch.setattr(
        calibration_logs, "Team", lambda *_, **__: SimpleNamespace(open=lambda: Asked(), close=lambda: None)
    )
    monkeypatch.setattr(calibration_logs, "Setting", lambda *_: None)
    monkeypatch.setattr(calibration_logs, "judged", lambda _: ALL)
    monkeypatch.setattr(calibration_logs, "looked_at", looked)
    monkeypatch.setattr(calibration_logs, "weighed", searched)
    own = [EffectSpec(name="tyre_relaxation", params={"length_m": 0.3})] if has else []
    car = replace(made_model(), effects=own)
    some = drained(calibration_logs.tyres(calibration_logs.OwnLogs(car, VEHICLE, [])))
    assert [one.name for one in some] == (["tyre_relaxation"] if told else [])
    assert not told or some[0].params["length_m"] == pytest.approx(0.3)


class Asked(NamedTuple):
    """A question that nobody opened."""

    null: Any = None
    blocks: Any = None
    suspects: tuple[Any, ...] = (SimpleNamespace(name="tyre_relaxation"), SimpleNamespace(name="grade"))
    broken: frozenset[str] | None = None


def drained(search: Generator[str, None, list[EffectSpec]]) -> list[EffectSpec]:
    try:
        while True:
            next(search)
    except StopIteration as end:
        return cast(list[EffectSpec], end.value)
