"""How long `learn` takes by itself, from logs and a calibrated folder to a learned one: the default kind."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from tools.measures._ledger import FOLDER
from tools.measures._summary import machine, rounded, summary
from tools.measures._unseen import ended
from tools.measures.map import logs_in
from tunefree_hil.bench import load
from tunefree_hil.config.load import load_model
from tunefree_hil.jobs.learn.calibrate import calibrate
from tunefree_hil.jobs.learn.options import CalibrateOptions

VALUE = "s of wall time of `learn` alone (default kind, its own number of steps), mkz_bywire"
NAME = "train"


def measure(
    logs: str = "",
    bench: str = "bench_configs/mkz_complete.toml",
    kind: str = "hybrid",
    minutes: float = 0.0,
    runs: int = 1,
    seed: int = 1,
    folder: str = FOLDER,
) -> dict[str, Any]:
    """`runs` calls of the command, one after the other. logs: '' those of the measure `collect`; minutes: 0 its own."""
    before, loaded, place = machine(), load(bench), Path(folder) / NAME
    sources, physics = logs_in(logs, folder), place / f"physics-{seed}"
    calibrated_s = None
    if not physics.is_dir():
        began = time.monotonic()
        ended(calibrate(CalibrateOptions(sources, loaded.vehicle.folder, physics, seed)))
        calibrated_s = time.monotonic() - began
    times, out = [], place / "model"
    for _ in range(runs):
        shutil.rmtree(out, ignore_errors=True)
        out.with_name(out.name + ".part").unlink(missing_ok=True)
        command = [
            sys.executable,
            "-m",
            "tunefree_hil",
            "learn",
            *map(str, sources),
            "--vehicle",
            loaded.vehicle.folder,
        ]
        command += ["--out", str(out), "--physics", str(physics), "--kind", kind, "--seed", str(seed), "--plain"]
        command += ["--minutes", f"{minutes:g}"] if minutes else []
        began = time.monotonic()
        subprocess.run(command, check=True, stdout=sys.stderr)
        times.append(time.monotonic() - began)
    load_model(out)
    training = json.loads((out / "card.json").read_text(encoding="utf-8"))["training"]
    detail = {
        "machine": before,
        "logs": len(sources),
        "kind": kind,
        "calibrate_s": calibrated_s,
        "each_s": times,
        "steps": training["steps"],
        "training_s": training["seconds"],
    }
    return summary(times, "s", rounded(detail))
