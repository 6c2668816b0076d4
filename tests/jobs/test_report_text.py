"""What is said of two candidates: where they fall it is said of both."""

from __future__ import annotations

from typing import Any

from tunefree_hil.jobs.report_text import comparison_text

SCORES = (0.4, 0.2)


def drives(score: float, replans: int = 0, outcome: str = "finished") -> dict[str, Any]:
    """One road of a candidate."""
    metrics = {"lateral_err_peak": score}
    return {"bend": {"score": score, "replans": replans, "outcome": outcome, "metrics": metrics}}


def test_a_better_set_is_told_in_score_peak_and_roads() -> None:
    told = comparison_text("mrac_on", drives(0.4), drives(0.2), SCORES)
    assert told == (
        "score 0.400 -> 0.200 (-50 %) against mrac_on; lateral peak 0.20 -> 0.10 m; 1 of 1 scenarios better, bend most"
    )


def test_re_plans_are_told_of_both() -> None:
    assert "; re-plans 4 -> 3; " in comparison_text("mrac_on", drives(0.4, 4), drives(0.2, 3), SCORES)
    assert "; re-plans 0 -> 1; " in comparison_text("mrac_on", drives(0.4), drives(0.2, 1), SCORES)


def test_what_is_not_driven_to_its_end_is_told_of_both() -> None:
    fallen = drives(0.4, 0, "left_lane")
    assert comparison_text("as_shipped", fallen, drives(0.2), SCORES).endswith("as_shipped NOT driven to the end: bend")
    both = comparison_text("as_shipped", fallen, fallen, SCORES)
    assert both.endswith("NOT driven to the end: bend; as_shipped neither: bend")
    assert comparison_text("as_shipped", drives(0.4), fallen, SCORES).endswith("; NOT driven to the end: bend")
