"""The stages of a commission: how each job is called, and how it goes on where it was cut off."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bench import load
from tunefree_hil.jobs.commission.plan import Plan, collect_wish
from tunefree_hil.jobs.run_folder import read_json

SHOWN = (
    "sentence", "figures", "holds", "scores", "outside", "margins", "minutes", "cells_full", "cells_wanted",
    "simulated_s", "beyond_envelope_s", "missing", "run", "model", "map", "kind", "free_run", "reduction_percent",
    "pedals", "best", "manual", "ratio", "held",
)  # fmt: skip


def kept(result: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """The part of a result that the report shows; the rest stands in the stage's own folder.

    Pictures are named as seen from `folder`, the commission's, so that it may be moved. replans: of the winner, where
    drives of it are told.
    """
    from tunefree_hil.jobs.report_text import replans
    from tunefree_hil.jobs.tune.candidates import TUNED

    found = {key: value for key, value in result.items() if key in SHOWN}
    tuned = (result.get("scenarios") or {}).get(TUNED)
    found |= {"replans": replans(tuned)} if tuned else {}
    pictures = [one for one in result.get("figures", []) if Path(one).suffix == ".png"]
    return {**found, "figures": [Path(os.path.relpath(one, folder)).as_posix() for one in pictures]}


def run_collect(plan: Plan) -> Iterator[Event]:
    """Guided collection on the vehicle."""
    from tunefree_hil.jobs.collect.collect import collect

    return collect(collect_wish(plan.asked, Path(plan.template.path), plan.collected))


def run_calibrate(plan: Plan) -> Iterator[Event]:
    """Actuators and physical constants; a folder whose result was never written down is made anew."""
    from tunefree_hil.jobs.learn.calibrate import calibrate

    plan.set_aside(["calibrate"])
    return calibrate(plan.logs, plan.vehicle.folder, plan.physics, plan.asked.seed)


def run_learn(plan: Plan) -> Iterator[Event]:
    """The plant, on the calibrated physics; a training that was cut off goes on, one that was done is not repeated."""
    from tunefree_hil.jobs.learn.learn import Asked, finished, learn

    asked = plan.asked
    wish = Asked(plan.logs, plan.vehicle.folder, plan.model, asked.kind, asked.seed, asked.minutes, plan.physics)
    return finished(wish) if plan.model.exists() else learn(wish)


def run_map(plan: Plan) -> Iterator[Event]:
    """The open-loop map that the controller drives by."""
    from tunefree_hil.jobs.learn.map import map_logs

    plan.set_aside(["map"])
    plan.map.mkdir(parents=True, exist_ok=True)
    return map_logs(plan.logs, plan.vehicle.folder, plan.map, plan.asked.seed)


def run_tune(plan: Plan) -> Iterator[Event]:
    """The search on the learned plant; verification is a stage of its own."""
    from tunefree_hil.jobs.tune.options import Asked
    from tunefree_hil.jobs.tune.tune import tune

    asked = plan.asked
    wish = Asked(
        bench=plan.write_bench(), trials=asked.trials, set_name=asked.set_name, bus=asked.bus,
        bench_bus=asked.bench_bus, out=plan.folder / "tune", resume=finished_tune(plan), verify=False,
        backend=asked.backend,
    )  # fmt: skip
    return tune(wish)


def run_verify(plan: Plan) -> Iterator[Event]:
    """Winner and baselines on the vehicle, over the roads that the bench file names by now."""
    from tunefree_hil.jobs.drive import own_session
    from tunefree_hil.jobs.tune.folder import keep_bench
    from tunefree_hil.jobs.tune.verify import verify

    run = tune_run(plan)
    keep_bench(run, load(plan.write_bench()))
    return verify(run, bus=plan.asked.bus, bench_bus=plan.asked.bench_bus, join=False, session=own_session())


def tune_run(plan: Plan) -> Path:
    """The newest run of the tune. Raises InputError where there is none."""
    run = finished_tune(plan)
    if run is None:
        raise InputError(
            "holds no finished tune", code="stage_missing", file=str(plan.folder / "tune"), hint="--from tune does it"
        )
    return run


def finished_tune(plan: Plan) -> Path | None:
    """The newest run of the tune that came to its end; None where there is none, or it was cut off."""
    runs = sorted(path.parent for path in (plan.folder / "tune").glob("*/run.json"))
    whole = [run for run in runs if read_json(run / "run.json").get("complete")]
    return whole[-1] if whole else None
