"""A name against a network without one, on drives that neither has seen; and the closed loop with and without it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.tools.gap_exam.drives_for_tests import DOMAIN
from tests.tools.gap_exam.test_score import case
from tools.gap_exam import beside
from tools.gap_exam.beside import Beside, chosen, compare_all, row_of, stated
from tools.gap_exam.cases import make, vehicle_of
from tools.gap_exam.driver import CONTROLLER
from tools.gap_exam.files import Run
from tools.gap_exam.hidden import NOTHING
from tools.gap_exam.residual_net import fitted
from tools.gap_exam.rows import exam_of

EXAM = exam_of(DOMAIN)
DEAD = {"steer_dead_time": {"delay_s": 0.15}}


def test_what_is_stated_is_put_in() -> None:
    said = {"name": "payload", "params": {"mass_kg": {"value": 200.0, "low": 1.0}, "ahead_m": 0.3}}
    assert stated({"effects": [said]}) == NOTHING._replace(payload=200.0, payload_ahead_m=0.3)
    assert stated(None) == stated({"verdict": "set", "effects": [], "set": ["grade"]}) == NOTHING


def truth(**more: Any) -> dict[str, Any]:
    return {"vehicle": 0, "effects": DEAD, "kind": "excited", "who": CONTROLLER, "seed": 5, "duration_s": 100.0, **more}


@pytest.mark.slow
@pytest.mark.timeout(240)
def test_the_true_name_closes_all_of_it_everywhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """And no name, none of it; both in a car that was recalibrated as the other was."""
    monkeypatch.setattr(beside, "UNSEEN_S", 40.0)
    none = {"same": np.zeros((4000, len(beside.ROWS))), "other": np.zeros((4000, len(beside.ROWS)))}
    monkeypatch.setattr(beside, "_network", lambda *args: none)
    right = beside.compare(EXAM, truth(), {"effects": [{"name": "steer_dead_time", "params": {"delay_s": 0.15}}]})
    assert right.name_same > 0.98 and right.name_other > 0.98 and right.replay_down > 0.9 and right.replay_worst < 0.02
    assert (right.net_same, right.net_other) == (0.0, 0.0)
    half = beside.compare(EXAM, truth(), {"effects": [{"name": "steer_dead_time", "params": {"delay_s": 0.075}}]})
    assert 0.2 < half.name_same < 0.9 and 0.2 < half.replay_down < 0.9
    nothing = beside.compare(EXAM, truth(), {"verdict": "none_missing", "effects": []})
    assert nothing.name_same == nothing.name_other == nothing.replay_down == 0.0


def test_a_quick_drive_is_quicker_than_all_others() -> None:
    vehicle = vehicle_of(DOMAIN, 0)
    quick = make(vehicle, {}, "quick", CONTROLLER, 3, 60.0).drive
    assert quick.body[300:, 0].min() > 15.5 and np.percentile(quick.body[:, 0], 20) > 18.0
    assert quick.body[:, 0].max() <= vehicle.limits.speed_mps
    assert np.percentile(np.abs(quick.body[:, 14]), 99.5) <= vehicle.limits.lateral_mps2


@pytest.mark.slow
@pytest.mark.timeout(240)
def test_the_network_learns_what_there_is_to_learn() -> None:
    """A gain, and the integral of another signal, on blocks that it never saw."""
    rng = np.random.default_rng(2)
    x = np.cumsum(rng.standard_normal((60, 50, 2)), axis=1) * 0.3
    y = np.stack([0.5 * x[:, :, 0], np.cumsum(x[:, :, 1], axis=1) / 50.0], axis=2)
    use = np.where(np.arange(60) % 4 == 3, 1, 0)
    use[-12:] = 2
    said = fitted(x, y, use, np.array([False, True]), {"unseen": x[-12:]})["unseen"]
    left = ((said - y[-12:]) ** 2).mean(axis=(0, 1)) / (y[-12:] ** 2).mean(axis=(0, 1))
    assert left.max() < 0.1


def test_compared_once_and_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    run, asked = Run(tmp_path), []
    cases = [case(k, "one", "steer_lag", seed=10 - k) for k in range(4)]
    cases += [case(8, "one", "steer_lag", found=False, seed=0), case(9, "none_missing", row="free", effects={}, seed=1)]

    def compare(exam: Any, truth: Any, answer: Any) -> Beside:
        asked.append(truth["seed"])
        return Beside(0.9, 0.6, 0.95, 0.1 * truth["seed"], 0.9, 0.01)

    monkeypatch.setattr(beside, "compare", compare)
    assert row_of([(run, one) for one in cases]) is None
    compare_all(run, EXAM, cases, 2)
    compare_all(run, EXAM, cases, 3)
    assert asked == [7, 8, 9], "the first by their seeds, each once"
    row = row_of([(run, one) for one in cases])
    assert row is not None and row.n == 3 and row.outcomes["right"] == 3
    assert row.figures["name_over_net_same"].value == pytest.approx(1.5)
    assert row.figures["name_beats_net_other"].value == 1.0 and row.figures["net_other"].value == pytest.approx(0.8)
    assert [one.number for one in chosen(cases, 9)] == [3, 2, 1, 0]
