"""Margins as a sentence's end and as a table, from the data of margins_report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

LESS = {"delay": "delay margin", "gain_up": "steer gain margin upward", "gain_down": "steer gain margin downward",
        "inside": "robustness within +/-20 %"}  # fmt: skip
HEAD = ("", "delay", "gain down", "gain up", "fails in +/-20 %", "beyond", "steering rate", "reversals")
NONE = "-"


def margin_words(margins: Mapping[str, Any], tuned: str) -> str:
    """'but with less delay margin than as_shipped: 60 ms against 110 ms', or both margins; '' where there are none.

    A winner that fails within +/-20 %, where nothing should, is said to.
    """
    if margins["reason"]:
        return ""
    less, against, mine = margins["less"], margins["against"], margins["vectors"][tuned]
    if less:
        words = "but with " + ", ".join(f"less {LESS[one['what']]} than {against}: {_pair(one)}" for one in less)
    elif against is None:
        words = f"delay margin {_delay(mine['delay'])}, and no manual vector drives all of them without a re-plan"
    else:
        words = f"delay margin {_delay(mine['delay'])} against {_delay(margins['vectors'][against]['delay'])}"
        words += f" of {against}"
    if mine["inside"]["failed"] and "inside" not in [one["what"] for one in less]:
        words += f"; it FAILS {_rate(mine['inside'])} drives within +/-20 %"
    return words


def margin_table(margins: Mapping[str, Any], tuned: str) -> list[str]:
    """One line a vector, '<' beside what the winner has less of than manual; then where it fails, what is missing."""
    vectors, less = margins["vectors"], {one["what"] for one in margins["less"]}
    rows = [HEAD, *(_row(name, one, less if name == tuned else set()) for name, one in vectors.items())]
    widths = [max(len(row[i]) for row in rows) for i in range(len(HEAD))]
    lines = ["  ".join(f"{cell:>{width}}" if i else f"{cell:{width}}"
                       for i, (cell, width) in enumerate(zip(row, widths, strict=True))) for row in rows]  # fmt: skip
    if less:
        lines.append(f"< marks what {tuned} has less of than {margins['against']}")
    lines += _where(tuned, vectors[tuned]["points"])
    lines += [f"{group}: not driven, {reason}" for group, reason in margins["missing"].items()]
    if margins["reason"]:
        lines.append(f"no margins: {margins['reason']}")
    return lines


def _where(tuned: str, points: Sequence[Mapping[str, Any]]) -> list[str]:
    """One line a scenario and end: with which cars."""
    cars: dict[tuple[str, str], list[str]] = {}
    for point in points:
        for key in point["failures"].items():
            cars.setdefault(key, []).append(point["what"])
    return [f"{tuned} fails in {scenario} ({outcome}) with {'; '.join(some)}"
            for (scenario, outcome), some in sorted(cars.items())]  # fmt: skip


def _row(name: str, one: Mapping[str, Any], less: set[str]) -> tuple[str, ...]:
    cells = {"delay": _delay(one["delay"]), "gain_down": _gain(one["gain_down"]), "gain_up": _gain(one["gain_up"]),
             "inside": _rate(one["inside"])}  # fmt: skip
    marked = [text + (" <" if what in less else "") for what, text in cells.items()]
    steering = one["steering"]
    rate = f"{steering['rate_rms_radps']:.3f} rad/s" if steering else NONE
    reversals = f"{steering['reversals_per_s']:.2f} /s" if steering else NONE
    return (name, *marked, _rate(one["beyond"], share=True), rate, reversals)


def _pair(less: Mapping[str, Any]) -> str:
    if less["what"] == "inside":
        return f"{_rate(less['tuned'])} drives fail against {_rate(less['manual'])}"
    show = _delay if less["what"] == "delay" else _gain
    return f"{show(less['tuned'])} against {show(less['manual'])}"


def _delay(margin: Mapping[str, Any] | None) -> str:
    if margin is None:
        return NONE
    return f"{'>= ' if margin['at_least'] else ''}{1e3 * margin['value']:.0f} ms"


def _gain(margin: Mapping[str, Any] | None) -> str:
    """The factor at which it is no longer calm."""
    if margin is None:
        return NONE
    beyond = "<= " if margin["value"] < 1.0 else ">= "
    return f"{beyond if margin['at_least'] else ''}{margin['value']:.2f}"


def _rate(rate: Mapping[str, Any] | None, *, share: bool = False) -> str:
    if rate is None or not rate["drives"]:
        return NONE
    return f"{rate['failed']} of {rate['drives']}" + (f" ({100.0 * rate['share']:.0f} %)" if share else "")
