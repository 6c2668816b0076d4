#!/usr/bin/env python3
"""`tools/make_effects_page.py`: writes the tables of docs/reference/effects.md from what the files of effects/ export.

Between the two marks of the page everything is replaced, the rest is left alone.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from tunefree_hil.base.contracts import Effect, Port, Prior, links_of, place_of  # noqa: E402
from tunefree_hil.effects import catalogue  # noqa: E402

PAGE = ROOT / "docs" / "reference" / "effects.md"
BEGIN, END = "<!-- tables: tools/make_effects_page.py -->", "<!-- end of tables -->"
GROUPS = {
    "Steering": (Port.STEER_A, Port.STEER_OUT, Port.STEER_B),
    "Throttle and driveline": (Port.THROTTLE_A, Port.THROTTLE_OUT, Port.THROTTLE_B),
    "Brake": (Port.BRAKE_A, Port.BRAKE_OUT, Port.BRAKE_B),
    "Body, tyres and surroundings": (Port.BODY,),
    "Sensing and timing": (Port.REPORT, Port.INS),
}
TIMES = {"steer_rad": "steering", "mass_kg": "mass", "wheelbase_m": "wheelbase"}


def tables() -> str:
    """All that stands between the marks."""
    every = catalogue()
    lines = [f"{len(every)} effects."]
    for title, ports in GROUPS.items():
        lines += ["", f"### {title}", *_group({name: one for name, one in every.items() if one.port in ports})]
    return "\n".join(lines) + "\n"


def _group(some: dict[str, Effect]) -> Iterator[str]:
    yield from (
        "",
        "| effect | place | parameter | neutral | searched | typical | breaks |",
        "|---|---|---|---|---|---|---|",
    )
    for name, one in some.items():
        place = place_of(one) or one.port.value
        links = ", ".join(link.value for link in links_of(one))
        for i, key in enumerate(one.neutral):
            first = (f"`{name}`", place, links) if i == 0 else ("", "", "")
            yield (
                f"| {first[0]} | {first[1]} | {key} | {_number(one.neutral[key])} | "
                f"{_range(one.priors[key])} | {_typical(one.priors[key])} | {first[2]} |"
            )
    yield from ("", "| effect | looks like | taken for | told apart by |", "|---|---|---|---|")
    for name, one in some.items():
        yield f"| `{name}` | {one.symptom} | {', '.join(one.impostors)} | {one.manoeuvre} |"


def _number(value: float) -> str:
    return "inf" if math.isinf(value) else f"{value:g}"


def _range(prior: Prior) -> str:
    return f"{prior.low:g}..{prior.high:g}{_times(prior)}{', log' if prior.scale == 'log' else ''}"


def _typical(prior: Prior) -> str:
    return f"{_number(prior.typical)}{_times(prior)}"


def _times(prior: Prior) -> str:
    """The vehicle's own size by which a prior is multiplied."""
    return f"×{TIMES[prior.times]}" if prior.times else ""


def page(text: str) -> str:
    """The page with new tables. Raises ValueError where a mark is missing."""
    before, _, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not end:
        raise ValueError(f"{PAGE.name} lacks the marks {BEGIN} and {END}")
    return f"{before}{BEGIN}\n{tables()}{END}{after}"


def main() -> int:
    """Rewrite the page."""
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
