"""The drives of issue 44 on the reference car: every one that shakes is caught, and no calm one is."""

from __future__ import annotations

import pytest

from tests.house import ROOT
from tunefree_hil.bench import load, parameters_of
from tunefree_hil.bench.batch import Batch, Job
from tunefree_hil.control.parameters import study_values
from tunefree_hil.grade.oscillation.report import OscillationReport, OscillationSignal
from tunefree_hil.jobs.tune.candidates import compute_baseline_vectors

CALM = ("as_shipped", "mrac_on")
SHAKING = "hasty"
# What the textbook rules gave for this bench before they minded the pedals' dead time (commit 52e18f2).
HASTY = {
    "mrac.t_ref_s": 0.0773, "lqr.q1": 0.00485, "lqr.q2": 0.00485, "lqr.q3": 0.00442, "lqr.q4": 0.00442,
    "station.kp": 3.077, "speed.kp_low": 10.0, "speed.ki_low": 25.0, "speed.kp_high": 10.0, "speed.ki_high": 25.0,
}  # fmt: skip
FAST_ROAD = "rav4_drive"  # straight at 13-20 m/s


@pytest.fixture(scope="module")
def reports() -> dict[tuple[str, str], OscillationReport]:
    """By name of the gain set and of the scenario."""
    bench = load(str(ROOT / "bench_configs" / "mkz_complete.toml"))
    hasty = {**study_values(), "mrac.p": 1e-4, **HASTY}
    vectors = {**compute_baseline_vectors(bench), SHAKING: parameters_of(bench, hasty)}
    keys = [(name, road) for name in (*CALM, SHAKING) for road in bench.spec.verify_scenarios]
    keys += [(name, road) for name in CALM for road in bench.spec.scenarios]
    with Batch(bench, bench.spec.verify_model, threads=1) as batch:
        driven = batch.drive([Job(vectors[name], bench.scenarios[road]) for name, road in keys])
    return {key: one.grade.oscillation for key, one in zip(keys, driven, strict=True) if one.grade is not None}


@pytest.mark.slow
@pytest.mark.compiled
def test_the_shaking_set_is_caught_and_the_calm_ones_are_not(
    reports: dict[tuple[str, str], OscillationReport],
) -> None:
    assert len(reports) == 35
    for (name, road), report in reports.items():
        assert report.is_oscillating == (name == SHAKING), (name, road, report.worst)
        if name == SHAKING:
            assert report.ratio_of(OscillationSignal.ACCEL) > 4.0, road
            assert report.ratio_of(OscillationSignal.THROTTLE) > 2.0, road
            assert report.ratio_of(OscillationSignal.PEDAL_ALTERNATION) > 2.0, road
    wheel = {finding.signal: finding for finding in reports[SHAKING, FAST_ROAD].findings}
    assert wheel[OscillationSignal.STEER_MEASURED].ratio > 10.0
    assert wheel[OscillationSignal.STEER_MEASURED].frequency_hz == pytest.approx(1.35, rel=0.05)
