"""Which block of a proof is shown."""

from __future__ import annotations

import numpy as np

from tunefree_hil.gap.verify import Traces
from tunefree_hil.jobs.gap.pictures import telling

T = np.linspace(0.0, 8.0, 81)


def block(missed: float, name: str = "report.brake_frac") -> Traces:
    return Traces(T, {name: 0.0 * T}, {"before": {name: 9.0 + T}, "recalibrated": {name: missed * np.sin(T)}})


def test_the_block_that_shows_most_of_what_is_missed_is_shown() -> None:
    some = [block(0.001), block(0.2), block(0.1)]
    assert telling(some, ("report.brake_frac",)) is some[1]
    assert telling(some, ("ins.speed_mps", "report.brake_frac")) is some[1], "the first that was measured"


def test_where_the_signal_was_not_measured_it_is_the_first_block() -> None:
    some = [block(0.1), block(0.2)]
    assert telling(some, ("ins.speed_mps",)) is some[0] and telling(some, ()) is some[0]
