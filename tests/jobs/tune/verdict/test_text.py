"""What is said of a verdict: what binds, where, by how much, and what oscillates."""

from __future__ import annotations

from typing import Any

from tunefree_hil.grade.oscillation.report import (
    DrivePlace,
    OscillationFinding,
    OscillationSignal,
    finding_as_data,
    finding_from_data,
)
from tunefree_hil.grade.requirements.verdict import DecidedGains, decide_verdict, judge_gains
from tunefree_hil.jobs.tune.verdict.text import (
    infeasible_text,
    requirement_table,
    road_oscillation_text,
    verdict_reason,
)

LIMITS = {"lateral_error_peak_m": 0.5, "replans": 0.0}


def decided(tuned_m: float | None, manual_m: float, score: float = 0.1) -> DecidedGains:
    def judged(score: float, lateral_m: float | None) -> Any:
        values = {"lateral_error_peak_m": lateral_m, "replans": 0.0}
        return judge_gains(score, {"bend": {"outcome": "finished", "requirements": values}}, LIMITS)

    return decide_verdict(judged(score, tuned_m), {"mrac_on": judged(0.2, manual_m)})


def test_reasons() -> None:
    assert verdict_reason(decided(0.1, 0.1)) == "all 2 judged requirements are met"
    assert "no manual set meets the requirements, the nearest is mrac_on" in verdict_reason(decided(0.1, 1.0))
    assert verdict_reason(decided(0.1, 0.1, 0.2)).startswith("mrac_on meets the requirements and is as good")
    rejected = verdict_reason(decided(1.0, 0.1))
    assert rejected.startswith("lateral_error_peak_m 1 > 0.5 on bend; the manual set mrac_on meets")
    assert "not judged" in verdict_reason(decided(None, 0.1))


def test_where_nothing_meets_them_what_binds_is_said_with_its_share() -> None:
    text = infeasible_text(decided(0.75, 1.0), 40)
    assert text.startswith("none of 40 trials and no manual set meets the requirements")
    assert "lateral_error_peak_m 0.75 > 0.5" in text and "by 50 % on bend" in text
    assert infeasible_text(decided(0.75, 0.1), 40) == "" == infeasible_text(decided(0.1, 1.0), 40)


def test_the_table_has_a_row_for_each_requirement_and_marks_a_violation() -> None:
    verdict = decided(0.1, 1.0)
    rows = requirement_table(
        {"tuned": verdict.tuned.judgement.as_data(), "mrac_on": verdict.best_manual.judgement.as_data()}
    )
    (lateral,) = [row for row in rows if row.startswith("lateral_error_peak_m")]
    assert lateral.split() == ["lateral_error_peak_m", "0.5", "0.1", "1!", "bend"]
    assert len(rows) == 2 + len(LIMITS) and all("\n" not in row for row in rows)


def test_the_worst_oscillation_over_the_roads_is_named() -> None:
    finding = OscillationFinding(
        OscillationSignal.STEER_MEASURED, 1.0, 0.05, "rad", 1.7, 3.0, 9.0, DrivePlace.STRAIGHT, 18.0
    )
    assert finding_from_data(finding_as_data(finding)) == finding
    drives = {
        "bend": {"oscillation": finding_as_data(finding._replace(amplitude=0.1))},
        "u_turn": {"oscillation": finding_as_data(finding)},
        "hill": {"oscillation": None},
    }
    assert road_oscillation_text(drives) == (
        "OSCILLATES on u_turn: steering wheel swings 57 deg at 1.7 Hz from 3.0 to 9.0 s, straight, at 18 m/s"
    )
    assert road_oscillation_text({"hill": {}}) == ""
