"""The verdict on tuned gains: requirements come first, then the gain over a manual set that meets them."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.grade.requirements.verdict import CRITERIA, GainsVerdict, JudgedGains, decide_verdict, judge_gains

LIMITS = {"lateral_error_peak_m": 0.5}


def gains(score: float, lateral_m: float = 0.1, outcome: str = "finished") -> JudgedGains:
    drive = {"outcome": outcome, "requirements": {"lateral_error_peak_m": lateral_m}}
    return judge_gains(score, {"bend": drive}, LIMITS)


@pytest.mark.parametrize(
    ("tuned", "manual", "verdict"),
    [
        (gains(0.1), gains(0.2), GainsVerdict.ACCEPTED),
        (gains(0.2 * (1.0 - 1.01 * CRITERIA.gain_margin)), gains(0.2), GainsVerdict.ACCEPTED),
        (gains(0.2 * (1.0 - 0.99 * CRITERIA.gain_margin)), gains(0.2), GainsVerdict.NO_GAIN),
        (gains(0.3), gains(0.2), GainsVerdict.NO_GAIN),
        (gains(0.3), gains(0.2, 0.6), GainsVerdict.ACCEPTED),
        (gains(0.1, 0.51), gains(0.2), GainsVerdict.REJECTED),
        (gains(0.1, 0.51), gains(0.2, 0.6), GainsVerdict.REJECTED),
        (gains(0.1, outcome="left_lane"), gains(0.2), GainsVerdict.REJECTED),
    ],
)
def test_one_manual_set(tuned: JudgedGains, manual: JudgedGains, verdict: GainsVerdict) -> None:
    assert decide_verdict(tuned, {"mrac_on": manual}).verdict is verdict


def test_the_manual_set_to_beat_meets_the_requirements() -> None:
    manuals = {"shaking": gains(0.05, 3.0), "calm": gains(0.3), "worse": gains(0.4)}
    decided = decide_verdict(gains(0.2), manuals)
    assert (decided.manual, decided.verdict) == ("calm", GainsVerdict.ACCEPTED), "a better score that shakes is none"
    data = decided.as_data()
    assert data["verdict"] == "ACCEPTED" and data["manual_requirements"]["shaking"]["met"] is False


def test_a_failed_drive_is_rejected_where_nothing_is_required() -> None:
    failed = judge_gains(0.1, {"bend": {"outcome": "diverged"}}, {})
    assert decide_verdict(failed, {"mrac_on": judge_gains(0.2, {}, {})}).verdict is GainsVerdict.REJECTED


@given(st.floats(0.0, 10.0), st.floats(0.0, 10.0), st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_no_score_makes_up_for_a_violation(tuned: float, manual: float, lateral_m: float, manual_m: float) -> None:
    verdict = decide_verdict(gains(tuned, lateral_m), {"mrac_on": gains(manual, manual_m)}).verdict
    assert (verdict is GainsVerdict.REJECTED) == (lateral_m > 0.5)
    assert verdict is not GainsVerdict.NO_GAIN or manual_m <= 0.5
