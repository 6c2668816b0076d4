"""The sentence of a gap: what is missing first, and why no model is written in one signal."""

from __future__ import annotations

from tests.gap.made_answer import answer
from tunefree_hil.jobs.gap_words import sentence_of

CLOSED = {"value": 0.97, "low": 0.9, "high": 0.99}
MISSING = "steer_dead_time (delay_s 0.070 s (0.069 to 0.071)) is missing; it closes 97 % (90 to 99) of the gap"


def test_what_is_missing_comes_first() -> None:
    told = sentence_of(answer(explained_frac=CLOSED, worse=[]))
    assert told == f"{MISSING} that recalibration leaves"


def test_why_no_model_is_written_comes_last_in_one_signal() -> None:
    worse = ["report.steer_rad of before.log (by 900 %)", *(f"report.{k} of before.log (by 9 %)" for k in range(6))]
    told = sentence_of(answer(explained_frac=CLOSED, worse=worse))
    assert told.startswith(MISSING) and told.count("before.log") == 1
    assert told.endswith("worse, above all report.steer_rad of before.log (by 900 %)")
