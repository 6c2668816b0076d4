"""The complete set of eleven parameters: is the tuned vehicle better than the best manual one, and than chance?"""

from __future__ import annotations

from typing import Any

from tools.measures._tuning import FIGURES, FOLDER, make_plan, measure_tuning, write_figure

VALUE = "score tuned / best manual baseline, reference vehicle, unseen scenarios, 11 parameters (median of study seeds)"
NAME = "tune11"


def measure(
    seeds: int = 2,
    trials: int = 0,
    scenarios: str = "",
    verify_scenarios: str = "",
    workers: int = 2,
    bench: str = "bench_configs/mkz_complete.toml",
    folder: str = FOLDER,
    figures: str = FIGURES,
) -> dict[str, Any]:
    """Study and random search with `seeds` seeds, all baselines. 0 trials: the bench file's number. Goes on when called
    again. `workers` benches run side by side, one a core.
    """
    plan = make_plan(bench, NAME, trials=trials, scenarios=scenarios, verify_scenarios=verify_scenarios, folder=folder)
    answer, rows = measure_tuning(plan, seeds, workers)
    answer["detail"]["figure"] = write_figure(rows, plan, answer["detail"]["manual"], figures, NAME)
    return answer
