"""MPC against LQR with preview: score after the same search, and what a plan costs in the controller's process.

Both controllers drive the same bench over the bus: same plants, scenarios, number of trials, sampler and seeds; each
search begins from the controller's own manual weights. Winners are judged on the verify model over its scenarios. Every
drive is a line of the ledger: a measure that was cut off goes on.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from tools.measures._ledger import FOLDER
from tools.measures._mpc_study import CONTROLLERS, LQR, MPC, MpcStudy, Search, judge, search, write_benches
from tools.measures._mpc_timing import measure_times
from tools.measures._rig import failed, replans
from tools.measures._side_by_side import side_by_side
from tools.measures._summary import machine, rounded, summary
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import load

VALUE = "score of tuned MPC / tuned LQR with preview on the verify model and its scenarios; same trials, sampler, seeds"


def measure(
    trials: int = 60,
    seeds: int = 3,
    workers: int = 2,
    seconds: int = 60,
    scenarios: str = "",
    verify_scenarios: str = "",
    bench: str = "bench_configs/mkz_mpc.toml",
    folder: str = FOLDER,
) -> dict[str, Any]:
    """Search with both controllers, judge the winners, then time the plans.

    n counts seeds. seconds: driven in lockstep and then in real time to time the plans; 0 leaves that out. scenarios,
    verify_scenarios: names with commas between, '' for those of the bench file.
    """
    if seeds < 1 or trials < 1:
        raise InputError(
            "a search needs a trial and a seed", code="usage", key="--seeds", hint="give 1 or more of both"
        )
    before, place = machine(), Path(folder) / "mpc"
    files = write_benches(Path(bench), place)
    spec = load(bench).spec
    study = MpcStudy(
        files, str(place), _chosen(scenarios, spec.scenarios), _chosen(verify_scenarios, spec.verify_scenarios), trials
    )
    manual = {name: judge(study, name, {}) for name in CONTROLLERS}
    winners: dict[tuple[str, int], dict[str, Any]] = {}
    for result in side_by_side(
        search, [Search(study, name, seed) for seed in range(1, seeds + 1) for name in CONTROLLERS], workers
    ):
        winners[result["controller"], result["seed"]] = result
        _print(f"{result['controller']}, seed {result['seed']}: {result['score']:.4f} in the search")
    rows = [_seed_row(study, winners, seed) for seed in range(1, seeds + 1)]
    detail: dict[str, Any] = {
        "machine": before,
        "bench": bench,
        "trials": trials,
        "sampler": spec.tune.sampler,
        "scenarios": list(study.scenarios),
        "verify_scenarios": list(study.verify_scenarios),
        "parameters": {name: list(winners[name, 1]["parameters"]) for name in CONTROLLERS},
        "manual": {name: _scores(result) for name, result in manual.items()},
        "manual_ratio": manual[MPC]["verify"]["score"] / manual[LQR]["verify"]["score"],
        "search_ratio_median": float(np.median([row["search_ratio"] for row in rows])),
        "seeds": rows,
    }
    if seconds:
        detail["times"] = {name: measure_times(files[name], seconds) for name in CONTROLLERS}
    return summary([row["ratio"] for row in rows], "of the tuned LQR's score", rounded(detail))


def _seed_row(study: MpcStudy, winners: dict[tuple[str, int], dict[str, Any]], seed: int) -> dict[str, Any]:
    judged = {name: judge(study, name, winners[name, seed]["parameters"]) for name in CONTROLLERS}
    return {
        "seed": seed,
        "ratio": judged[MPC]["verify"]["score"] / judged[LQR]["verify"]["score"],
        "search_ratio": winners[MPC, seed]["score"] / winners[LQR, seed]["score"],
        **{name: {**_scores(judged[name]), "parameters": winners[name, seed]["parameters"]} for name in CONTROLLERS},
    }


def _scores(judged: dict[str, Any]) -> dict[str, Any]:
    """Scores of one vector on both models; the largest swing of the steering, and what went wrong, on the vehicle."""
    drives = judged["verify"]["scenarios"]
    swings = [drive["requirements"].get("steer_oscillation_rad") or 0.0 for drive in drives.values()]
    return {
        "search_model": judged["search"]["score"],
        "verify_model": judged["verify"]["score"],
        "steer_oscillation_rad": max(swings),
        "replans": replans(drives),
        "failed": failed(drives),
    }


def _chosen(text: str, known: list[str]) -> tuple[str, ...]:
    chosen = tuple(name for name in known if not text or name in text.split(","))
    if not chosen:
        hint = f"names of the bench file: {', '.join(known)}"
        raise InputError(f"no scenario in {text!r}", code="usage", key="--scenarios", hint=hint)
    return chosen


def _print(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
