"""`compare --fail-if`: a condition on a metric that makes a comparison fail, for use in CI.

    METRIC [@SCENARIO] OP VALUE      lateral_err_peak > +5%     score@u_turn >= 0.4     replans > 0

OP is one of > >= < <=. VALUE is a number, or +N% / -N% relative to the first run's value. Without @SCENARIO the value
combined over all scenarios is compared. A condition is checked in every run but the first.
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

SCORE, REPLANS, FAILED = "score", "replans", "failed"  # eq. 7, number of re-plans, number of failed drives
METRIC_NAMES = (SCORE, REPLANS, FAILED, *TABLE)
MIN_NAME_SIMILARITY = 0.7  # 0 to 1; more similar names are suggested for a misspelt one
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
    """A parsed condition. limit: a number, or with `relative` the change as a share of the first run's value."""

    text: str
    metric: str
    scenario: str  # '' for the combined value
    op: str
    limit: float
    relative: bool


class ConditionResult(NamedTuple):
    """A condition checked in one run. holds: the comparison fails; also True where a value is missing."""

    condition: str
    run: str
    holds: bool
    words: str


def parse_condition(text: str, scenarios: Iterable[str]) -> Condition:
    """Parse a condition; scenarios: the names that may follow @. Raises InputError for an invalid one."""
    match = _FORM.fullmatch(text)
    if match is None:
        raise _condition_error(text, "is not a condition", f"write {GRAMMAR}")
    metric, scenario, op, number, percent = match.groups()
    if metric not in METRIC_NAMES:
        near = get_close_matches(metric, METRIC_NAMES, cutoff=MIN_NAME_SIMILARITY)
        guess = f"Did you mean {' or '.join(near)}? " if near else ""
        raise _condition_error(text, f"has an unknown metric {metric!r}", f"{guess}one of {', '.join(METRIC_NAMES)}")
    known = list(scenarios)
    if scenario is not None and scenario not in known:
        message = f"has a scenario that not all runs drove: {scenario!r}"
        raise _condition_error(text, message, f"one of {', '.join(known)}")
    number, relative = (number.removesuffix("%"), True) if number.endswith("%") else (number, bool(percent))
    limit = _parse_limit(text, number, relative)
    return Condition(text.strip(), metric, scenario or "", op, 0.01 * limit if relative else limit, relative)


def _parse_limit(text: str, number: str, relative: bool) -> float:
    if relative and not _PERCENT.fullmatch(number):
        raise _condition_error(text, f"has no sign before {number}%", "write +5% or -5%: relative to the first run")
    try:
        limit = float(number)
    except ValueError:
        limit = math.nan
    if not math.isfinite(limit):
        raise _condition_error(text, f"compares with {number!r}, which is not a number", f"write {GRAMMAR}")
    return limit


def check_condition(condition: Condition, values: Mapping[str, float | None]) -> list[ConditionResult]:
    """Check a condition in every run but the first. values: the metric's value by run, the first run first."""
    first_label = next(iter(values))
    first = values[first_label]
    results = []
    for label, value in list(values.items())[1:]:
        if value is None or (condition.relative and first is None):
            lacking = label if value is None else first_label
            text = f"{condition.metric} is not available in {lacking}, so the condition cannot be checked"
            results.append(ConditionResult(condition.text, label, True, text))
            continue
        limit = condition.limit if not condition.relative else (first or 0.0) * (1.0 + condition.limit)
        holds = _OPS[condition.op](value, limit)
        where = f"@{condition.scenario}" if condition.scenario else ""
        text = f"{condition.metric}{where} {value:.4g} {'' if holds else 'not '}{condition.op} {limit:.4g}"
        results.append(ConditionResult(condition.text, label, holds, text + _relative_note(condition, first)))
    return results


def _relative_note(condition: Condition, first: float | None) -> str:
    return f" ({100.0 * condition.limit:+.4g} % of {first:.4g})" if condition.relative else ""


def _condition_error(text: str, message: str, hint: str) -> InputError:
    return InputError(f"{text!r} {message}", code="bad_condition", key="--fail-if", hint=hint)
