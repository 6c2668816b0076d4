"""The stages of a commission: how each job is called, and how it resumes."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bench import load
from tunefree_hil.jobs.commission.plan import CommissionPlan, make_collect_options, make_tune_options
from tunefree_hil.jobs.run_folder import read_json

RESULT_KEYS = frozenset(
    (
        *(
            "sentence",
            "figures",
            "holds",
            "verdict",
            "scores",
            "outside",
            "margins",
            "minutes",
            "cells_full",
            "cells_wanted",
        ),
        *("simulated_s", "beyond_envelope_s", "missing", "run", "model", "map", "kind", "free_run"),
        *("reduction_percent", "pedals", "best", "manual", "ratio", "held"),
    )
)


def select_result(result: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """The part of a result that the report needs; the rest is in the folder of the stage.

    Args:
        result: Data of the result event of a job.
        folder: Of the commission. Paths of figures become relative to it, so that it can be moved.

    Returns:
        The data, with `replans` of the winner where its drives are in the result.
    """
    from tunefree_hil.jobs.report_text import total_replans
    from tunefree_hil.jobs.tune.candidates import TUNED

    selected = {key: value for key, value in result.items() if key in RESULT_KEYS}
    tuned = (result.get("scenarios") or {}).get(TUNED)
    selected |= {"replans": total_replans(tuned)} if tuned else {}
    figures = [figure for figure in result.get("figures", []) if Path(figure).suffix == ".png"]
    return {**selected, "figures": [Path(os.path.relpath(figure, folder)).as_posix() for figure in figures]}


def run_collect(plan: CommissionPlan) -> Iterator[Event]:
    """Guided collection on the vehicle."""
    from tunefree_hil.jobs.collect.collect import collect

    return collect(make_collect_options(plan.options, Path(plan.template.path), plan.collected))


def run_calibrate(plan: CommissionPlan) -> Iterator[Event]:
    """Actuators and physical constants; a folder without a stored result is made again."""
    from tunefree_hil.jobs.learn.calibrate import calibrate
    from tunefree_hil.jobs.learn.options import CalibrateOptions

    plan.set_aside(["calibrate"])
    return calibrate(CalibrateOptions(plan.logs, plan.vehicle.folder, plan.physics, plan.options.seed))


def run_learn(plan: CommissionPlan) -> Iterator[Event]:
    """The plant, on the calibrated physics; an interrupted training resumes, a finished one is not repeated."""
    from tunefree_hil.jobs.learn.learn import learn, report_result
    from tunefree_hil.jobs.learn.options import LearnOptions

    options = LearnOptions(
        logs=plan.logs,
        vehicle=plan.vehicle.folder,
        out=plan.model,
        kind=plan.options.kind,
        seed=plan.options.seed,
        minutes=plan.options.minutes,
        physics=plan.physics,
    )
    return report_result(options) if plan.model.exists() else learn(options)


def run_map(plan: CommissionPlan) -> Iterator[Event]:
    """The open-loop map of the controller."""
    from tunefree_hil.jobs.learn.map import map_logs
    from tunefree_hil.jobs.learn.options import MapOptions

    plan.set_aside(["map"])
    plan.map.mkdir(parents=True, exist_ok=True)
    return map_logs(MapOptions(plan.logs, plan.vehicle.folder, plan.map, plan.options.seed))


def run_tune(plan: CommissionPlan) -> Iterator[Event]:
    """The search on the learned plant; the verification is a stage of its own."""
    from tunefree_hil.jobs.tune.tune import tune

    more = {"out": plan.folder / "tune", "resume": find_finished_tune(plan), "verify": False}
    return tune(make_tune_options(plan.options, plan.write_bench(), **more))


def run_verify(plan: CommissionPlan) -> Iterator[Event]:
    """Winner and baselines on the vehicle, in the scenarios that the bench file has now."""
    from tunefree_hil.jobs.options.records import VerifyOptions
    from tunefree_hil.jobs.tune.folder import write_bench_file
    from tunefree_hil.jobs.tune.verify import verify

    run = require_finished_tune(plan)
    write_bench_file(run, load(plan.write_bench()))
    return verify(VerifyOptions(run, plan.options.bus, plan.options.bench_bus))


def require_finished_tune(plan: CommissionPlan) -> Path:
    """The newest run of the tune. Raises InputError where there is none."""
    run = find_finished_tune(plan)
    if run is None:
        hint = "--from tune repeats the stage"
        raise InputError("has no finished tune", code="stage_missing", file=str(plan.folder / "tune"), hint=hint)
    return run


def find_finished_tune(plan: CommissionPlan) -> Path | None:
    """The newest finished run of the tune, None without one."""
    runs = sorted(path.parent for path in (plan.folder / "tune").glob("*/run.json"))
    finished = [run for run in runs if read_json(run / "run.json").get("complete")]
    return finished[-1] if finished else None
