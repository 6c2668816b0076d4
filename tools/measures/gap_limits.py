"""How small may an effect be and `gap` still name it? Of every effect, by bisection over the logs of its exam."""

from __future__ import annotations

from typing import Any

from tools.measures._gap_exam import HOURS, RUN, Asked, asked, there_is_gap
from tools.measures._summary import rounded
from tunefree_hil.base.errors import InputError

VALUE = "ms of extra steering dead time that gap names in 90 % of logs, alone and right; all other effects in detail"
EFFECT = "steer_dead_time"


def measure(
    run: str = RUN,
    domain: str = "",
    rows: str = "limits,one",
    part: str = "1/1",
    logs: int = 0,
    hours: float = HOURS,
    unfrozen: int = 0,
) -> dict[str, Any]:
    """Options as of gap_exam; the rows `limits` and `one` of the same run. n: logs of the effect; low, high: 95 % of
    the curve through them (see tools/gap_exam/ladder.py). Of an effect without a limit the value is None in detail."""
    there_is_gap()
    detail = asked(Asked(run, domain, rows, part, logs, hours, "", unfrozen=bool(unfrozen)))
    return limit_of(detail, EFFECT)


def limit_of(detail: dict[str, Any], name: str) -> dict[str, Any]:
    """The limit of a dead time as a measure's answer, in ms; InputError where none of its logs were named."""
    found = detail["limits"].get(name)
    if found is None or found["value"] is None:
        said = "no log of it is answered yet" if found is None else f"never named in 90 % of its {found['n']} logs"
        raise InputError(f"{name}: {said}", code="exam", hint="detail: table.md in the run's folder")
    value, low, high = (None if found[key] is None else 1e3 * found[key] for key in ("value", "low", "high"))
    return {"value": value, "unit": "ms", "n": found["n"], "low": low, "high": high, "detail": rounded(detail)}
