"""`--fail-if`: a condition on a metric that makes a comparison fail, for a team's CI.

    METRIC [@SCENARIO] OP VALUE      lateral_err_peak > +5%     score@u_turn >= 0.4     replans > 0

OP is > >= < <=. VALUE is a number, or +N% / -N%: the first run's value and N percent more or less. Without @SCENARIO it
is the value combined over all scenarios. A condition is looked at in every run but the first.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Iterable, Mapping
from difflib import get_close_matches
from typing import NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.grade.table import TABLE

# beside the metrics: eq. 7, re-plans, drives not driven to the end
SCORE, REPLANS, FAILED = "score", "replans", "failed"
NAMES = (SCORE, REPLANS, FAILED, *TABLE)
NEAR = 0.7  # likeness of names, 0 to 1, from which on one is taken for a misspelt other
GRAMMAR = "METRIC [@SCENARIO] OP VALUE, such as 'lateral_err_peak > +5%', 'score@u_turn >= 0.4' or 'replans > 0'"
_OPS: dict[str, Callable[[float, float], bool]] = {
    ">": operator.gt,
    ">=": operator.ge,
    "<": operator.lt,
    "<=": operator.le,
}
_FORM = re.compile(r"\s*([A-Za-z_]\w*)\s*(?:@\s*([^\s<>=]+)\s*)?(>=|<=|>|<)\s*(\S+)\s*(%?)\s*")
_PERCENT = re.compile(r"[+-]\d+(\.\d*)?|[+-]\.\d+")


class Condition(NamedTuple):
    """A condition as asked for. limit: a number, or where `relative` the share by which the first run's is exceeded."""

    text: str
    metric: str
    scenario: str  # '' for the combined value
    op: str
    limit: float
    relative: bool


class Finding(NamedTuple):
    """A condition in one run. holds: the comparison fails, also where it cannot be told (words say so)."""

    condition: str
    run: str
    holds: bool
    words: str


def parse_condition(text: str, scenarios: Iterable[str]) -> Condition:
    """A condition. Raises InputError that says what is wrong with it."""
    match = _FORM.fullmatch(text)
    if match is None:
        raise _bad(text, "is no condition", f"write {GRAMMAR}")
    metric, scenario, op, number, percent = match.groups()
    if metric not in NAMES:
        near = get_close_matches(metric, NAMES, cutoff=NEAR)
        guess = f"did you mean {' or '.join(near)}? " if near else ""
        raise _bad(text, f"names no metric: {metric!r}", f"{guess}one of {', '.join(NAMES)}")
    known = list(scenarios)
    if scenario is not None and scenario not in known:
        raise _bad(text, f"names no scenario that all runs drove: {scenario!r}", f"one of {', '.join(known)}")
    number, relative = (number.removesuffix("%"), True) if number.endswith("%") else (number, bool(percent))
    if relative and not _PERCENT.fullmatch(number):
        raise _bad(text, f"has no sign before {number}%", "write +5% or -5%: relative to the first run")
    try:
        limit = float(number)
    except ValueError:
        limit = math.nan
    if not math.isfinite(limit):
        raise _bad(text, f"compares with {number!r}, which is no number", f"write {GRAMMAR}")
    return Condition(text.strip(), metric, scenario or "", op, 0.01 * limit if relative else limit, relative)


def judge_condition(condition: Condition, values: Mapping[str, float | None]) -> list[Finding]:
    """The condition in every run but the first. values: of the metric, by run, the first run's first."""
    first_label = next(iter(values))
    first = values[first_label]
    findings = []
    for label, value in list(values.items())[1:]:
        if value is None or (condition.relative and first is None):
            lacking = label if value is None else first_label
            words = f"{condition.metric} could not be had in {lacking}, so the condition cannot be told"
            findings.append(Finding(condition.text, label, True, words))
            continue
        limit = condition.limit if not condition.relative else (first or 0.0) * (1.0 + condition.limit)
        holds = _OPS[condition.op](value, limit)
        where = f" in {condition.scenario}" if condition.scenario else ""
        said = f"{condition.metric}{where} is {value:.4g}, {'' if holds else 'not '}{condition.op} {limit:.4g}"
        findings.append(Finding(condition.text, label, holds, said + _beside(condition, first)))
    return findings


def _beside(condition: Condition, first: float | None) -> str:
    return f" ({100.0 * condition.limit:+.4g} % on {first:.4g})" if condition.relative else ""


def _bad(text: str, message: str, hint: str) -> InputError:
    return InputError(f"{text!r} {message}", code="bad_condition", key="--fail-if", hint=hint)
