"""Free run of every kind of learned plant on unseen drives, beside the fitted physics; bars, and the paper's Fig. 3b.

Learned from the logs of `collect` on the reference vehicle; what is there of an earlier call is used again.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tools.measures._ledger import FIGURES, FOLDER
from tools.measures._summary import machine, rounded
from tools.measures._unseen import ended, unseen_logs
from tools.measures.figures.headings import HeadingRun, draw_headings
from tools.measures.map import logs_in
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import Bench, load
from tunefree_hil.config.load import load_model
from tunefree_hil.config.schema import ModelSpec
from tunefree_hil.figures.learning.training import draw_free_run
from tunefree_hil.figures.style import save
from tunefree_hil.jobs.learn.calibrate import calibrate
from tunefree_hil.jobs.learn.learn import learn
from tunefree_hil.jobs.learn.options import CalibrateOptions, LearnOptions
from tunefree_hil.learn.compiled_process import CompiledProcess
from tunefree_hil.learn.drives.read import read_drives
from tunefree_hil.learn.drives.split import find_complete_parts
from tunefree_hil.learn.evaluation.free_run import (
    EvaluationOptions,
    FreeRunErrors,
    error_reduction,
    evaluate_models,
    run_headings,
    table_from_errors,
)
from tunefree_hil.learn.evaluation.motion import MotionTrack, find_starts, is_hilly, make_motion_tracks

VALUE = "percent that the 10 s position error of hybrid is below the fitted physics', level, unseen drives, mkz_bywire"
NAME = "freerun"
KINDS = "hybrid,lstm,mlp,rule_based,paper"
SPACED = "paper"  # once more with samples further apart
NEEDED = ("report.speed_mps", "ins.x_m", "ins.heading_rad")
AIMS_M = {"1": 0.1, "3": 0.3, "10": 2.0}
PICTURE_S = 20.0
LEAST_STARTS = 200


def measure(
    logs: str = "",
    bench: str = "bench_configs/mkz_complete.toml",
    kinds: str = KINDS,
    seed: int = 1,
    minutes: float = 0.0,
    spacing_s: float = 0.05,
    gains: int = 3,
    hills: int = 2,
    every_s: float = 1.0,
    folder: str = FOLDER,
    figures: str = FIGURES,
) -> dict[str, Any]:
    """Learn each kind (minutes: 0 is each one's own), drive what none has seen, and let all run freely on it.

    logs: a folder of logs to learn from; '' those that the measure `collect` has left. spacing_s: of a second training
    of kind paper (0: none). gains, hills: sets of unseen drives on level ground, on slopes. n: level starts.
    """
    before, loaded, place = machine(), load(bench), Path(folder) / NAME
    sources = logs_in(logs, folder)
    models = learned(loaded, sources, learned_in(folder, loaded, sources), kinds.split(","), seed, minutes, spacing_s)
    unseen = unseen_logs(bench, place / "unseen", gains, hills)
    tracks = {ground: unseen_tracks(some, loaded) for ground, some in unseen.items()}
    with CompiledProcess() as worker:
        judged = judged_on(worker, models, loaded, [*tracks["level"], *tracks["hills"]], every_s)
        heading = heading_on(worker, models, loaded, tracks["level"])
    tables = {name: table_from_errors(one, seed) for name, one in judged.items()}
    found = error_reduction(judged["hybrid"], judged["physics"], 10.0, seed=seed)
    if found["n"] < LEAST_STARTS:
        print(f"only {found['n']} level starts: {LEAST_STARTS} are asked for", file=sys.stderr)
    detail = {
        "machine": before,
        "logs": len(sources),
        "reductions_percent": reductions(judged, seed),
        "aims_m": AIMS_M,
        "kinds": tables,
        "cards": {name: card_words(model) for name, model in models.items()},
        "figures": [
            str(save(draw_free_run(tables), Path(figures) / "freerun.png")),
            str(save(draw_headings(heading), Path(figures) / "freerun_heading.png")),
        ],
    }
    return {
        "value": found["value"], "unit": "percent", "n": found["n"], "low": found["low"], "high": found["high"],
        "detail": rounded(detail),
    }  # fmt: skip


def learned_in(folder: str, bench: Bench, logs: Sequence[Path]) -> Path:
    """Where the models of these logs lie, for every measure that wants them."""
    heard = hashlib.sha256(b"".join(hashlib.sha256(path.read_bytes()).digest() for path in logs)).hexdigest()
    return Path(folder) / "learned" / f"{Path(bench.file).stem}-{heard[:12]}"


def learned(
    bench: Bench, logs: Sequence[Path], place: Path, kinds: Sequence[str], seed: int, minutes: float, spacing_s: float
) -> dict[str, ModelSpec]:
    """'physics' and every kind, from the same logs and the same split; folders of an earlier call are taken."""
    physics = place / f"physics-{seed}"
    if not physics.is_dir():
        ended(calibrate(CalibrateOptions(logs, bench.vehicle.folder, physics, seed)))
    wanted = [(kind, kind, 0.01) for kind in kinds]
    if spacing_s and SPACED in kinds:
        wanted.append((f"{SPACED} at {spacing_s:g} s", SPACED, spacing_s))
    models = {"physics": load_model(physics)}
    for name, kind, spacing in wanted:
        out = place / f"{name.replace(' ', '-')}-{seed}-{minutes:g}"
        if not out.is_dir():
            asked = LearnOptions(list(logs), bench.vehicle.folder, out, kind, seed, minutes or None, physics, spacing)
            ended(learn(asked))
        models[name] = load_model(out)
    return models


def unseen_tracks(logs: Sequence[Path], bench: Bench) -> list[MotionTrack]:
    """The stretches without a gap of unseen logs."""
    if not logs:
        return []
    found: list[MotionTrack] = []
    for drive in read_drives(list(logs), bench.codec):
        needed = [name for name in NEEDED if drive.get(name) is not None]
        found += make_motion_tracks(find_complete_parts(drive, needed), bench.vehicle)
    return found


def judged_on(
    worker: CompiledProcess,
    models: Mapping[str, ModelSpec],
    bench: Bench,
    tracks: Sequence[MotionTrack],
    every_s: float,
) -> dict[str, FreeRunErrors]:
    """Free run of all models from the same starts; says which one is done."""
    options = EvaluationOptions(every_s=every_s)
    asked = worker.call(evaluate_models, models, bench.vehicle, list(tracks), options)
    while True:
        try:
            print(f"free run of {next(asked)} done", file=sys.stderr, flush=True)
        except StopIteration as end:
            return end.value


def heading_on(
    worker: CompiledProcess, models: Mapping[str, ModelSpec], bench: Bench, tracks: Sequence[MotionTrack]
) -> HeadingRun:
    """The level start whose heading turns most in PICTURE_S. Raises InputError where no drive is that long."""
    best: tuple[float, MotionTrack, int] | None = None
    for track in tracks:
        ahead = round(PICTURE_S / track.dt_s)
        for row in find_starts(track, round(1.0 / track.dt_s), ahead, round(1.0 / track.dt_s)):
            turned = float(np.abs(np.diff(track.heading_rad[row : row + ahead])).sum())
            if not is_hilly(track, row, ahead) and (best is None or turned > best[0]):
                best = (turned, track, row)
    if best is None:
        raise InputError(f"no unseen drive has {PICTURE_S:g} s to show", code="too_short", key="bench")
    _, track, row = best
    kinds = worker.wait_for_result(run_headings, dict(models), bench.vehicle, track, row, PICTURE_S)
    rows = len(next(iter(kinds.values())))
    time_s = track.dt_s * np.arange(rows, dtype=np.float64)
    return HeadingRun(
        time_s, track.heading_rad[row : row + rows], kinds, f"The unseen start that turns most: {track.name}"
    )


def reductions(judged: Mapping[str, FreeRunErrors], seed: int) -> dict[str, Any]:
    """Of hybrid's 10 s position error against every other kind, level and hills."""
    found: dict[str, Any] = {}
    for ground, hills in (("level", False), ("hills", True)):
        if bool((judged["hybrid"].is_on_hill == hills).any()):
            found[ground] = {
                name: error_reduction(judged["hybrid"], one, 10.0, hills=hills, seed=seed)
                for name, one in judged.items()
                if name != "hybrid"
            }
    return found


def card_words(model: ModelSpec) -> dict[str, Any]:
    """What a reader asks of a model's card."""
    card = json.loads((Path(model.folder) / "card.json").read_text(encoding="utf-8"))
    training = card.get("training") or {}
    return {
        "split": card.get("split"),
        "seconds": card.get("seconds"),
        "steps": training.get("steps"),
        "held_out": training.get("score"),
        "untrained": training.get("untrained"),
        "stopped": training.get("stopped"),
    }
