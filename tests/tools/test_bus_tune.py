"""The measure of a study over the bus: what it reads from one, and how it extrapolates."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from tests.tune.drive_study import bowl, settings
from tools.measures import bus_tune
from tunefree_hil.jobs.run_folder import RunFolder
from tunefree_hil.tune.study import open_study
from tunefree_hil.tune.trial import Evaluation
from tunefree_hil.tune.trial_loop import run_generations


def test_the_first_trials_stand_for_themselves_and_the_others_for_the_rest() -> None:
    seconds = [1.0] * bus_tune.FIRST + [3.0, 5.0] * 20
    totals = bus_tune._totals_s(seconds, 800)
    assert totals[0] == pytest.approx(10.0 + 790 * 4.0)
    low, high = np.percentile(totals[1:], [2.5, 97.5])
    assert low < totals[0] < high and low > 10.0 + 790 * 3.0 and high < 10.0 + 790 * 5.0
    assert bus_tune._totals_s([2.0] * 3, 800)[0] == pytest.approx(1600.0)


def test_seconds_are_the_study_s_own(tmp_path: Path) -> None:
    def evaluate(points: Mapping[int, dict[str, float]]) -> list[Evaluation]:
        time.sleep(0.2)
        return [
            Evaluation(bowl(values).score, {"a": {"outcome": "finished" if slot else "left_lane"}})
            for slot, values in points.items()
        ]

    with open_study(tmp_path / "study.db", settings("tpe_independent")._replace(in_flight=2)) as study:
        list(run_generations(study, 4, evaluate))
    timed = bus_tune._read(RunFolder(tmp_path, {}), 3)
    assert len(timed.seconds) == 3 and all(0.1 <= one < 60.0 for one in timed.seconds)
    assert (timed.early, timed.drives) == (1, 3)
    assert bus_tune._sampling_s(timed, 200) > 0.0
