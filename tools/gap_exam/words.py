"""Figures and limits as people read them: rounded, in plain notation, with their unit said once."""

from __future__ import annotations

import math

from tools.gap_exam.catalogue import kind_of
from tools.gap_exam.limits import Limit, is_less_worse
from tools.gap_exam.statistics import Figure

SHARES = {"right", "right_or_in_set", "in_set", "partial", "wrong", "silent", "cannot_test", "failed", "at_least_one",
          "covered", "right_link", "forced_right", "forced_wrong", "none_of_these", "absorbed", "absorbed_true",
          "value_error_median", "value_error_90th", "gap_closed_median", "gap_closed_10th", "replay_down",
          "replay_worst", "name_same", "net_same", "name_other", "net_other", "name_over_net_same",
          "name_beats_net_other"}  # fmt: skip
DIGITS = 3
OPEN, ARROW = "open", "↓"


def plain(value: float) -> str:
    """Three digits without an exponent: '0.0244', '11 000'."""
    if not math.isfinite(value):
        return "-"
    rounded = float(f"{value:.{DIGITS}g}")
    decimals = DIGITS - 1 - math.floor(math.log10(abs(rounded))) if rounded else 0
    text = f"{rounded:,.{max(decimals, 0)}f}".replace(",", " ")
    return text.rstrip("0").rstrip(".") if "." in text else text


def said(name: str, figure: Figure) -> str:
    """A figure with its interval: '91.2 % (86 to 94.6, n = 240)'."""
    scale, unit = (100.0, " %") if name in SHARES else (1.0, " s" if name == "seconds" else "")
    value, low, high = (plain(math.nan if one is None else scale * one) for one in figure[:3])
    return f"{value}{unit} ({low} to {high}, n = {figure.n})"


def limit_words(one: Limit) -> str:
    """The smallest value that is named, with its unit and interval, from slight to gross: '0.13 s (0.06 to 0.36)'.

    'or less' (of limits 'or more') where all that was asked is named; 'open' for an end that nothing was asked beyond;
    'not up to' where not even the largest size asked is named in 90 % of logs. Gains by how far they are from 1.
    """
    spread = f" ({' to '.join(OPEN if edge is None else plain(edge) for edge in (one.low, one.high))})"
    if one.low is None and one.high is None:
        spread = f" ({OPEN} on both sides)" if one.value is not None and not one.or_less else ""
    elif one.or_less and one.high == one.value:
        spread = ""  # nothing that 'or less' does not say
    if one.value is None:
        way = "not down to" if is_less_worse(one.name) else "not up to"
        return f"{way} {_measured(one, one.steps[-1][1])}{spread}"
    return f"{_measured(one, one.value)}{_beyond(one) if one.or_less else ''}{spread}"


def label(name: str) -> str:
    """An effect's name, with an arrow where the smaller value is the grosser effect."""
    return f"{name} {ARROW}" if is_less_worse(name) else name


def excited_words(one: Limit) -> str:
    """The same by the drives that excite."""
    if one.excited is None:
        return "not reached"
    return f"{_measured(one, one.excited)}{_beyond(one) if one.excited_or_less else ''}"


def _measured(one: Limit, value: float) -> str:
    prefix = "1 ± " if kind_of(one.name).way == "factor" else ""
    return f"{prefix}{plain(value)}{'' if one.unit == '1' else f' {one.unit}'}"


def _beyond(one: Limit) -> str:
    """Slighter is less, but of a limit it is more."""
    return " or more" if is_less_worse(one.name) else " or less"
