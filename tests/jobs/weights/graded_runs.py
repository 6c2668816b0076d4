"""Run folders of graded logs and files of pairs, as the command reads them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from tests.grade.weight_regression.made_pairs import METRICS
from tunefree_hil.config.dump import to_toml
from tunefree_hil.episode.recording import make_recording, save_recording
from tunefree_hil.grade.score import FINISHED
from tunefree_hil.jobs.run_folder import RunFolder, write_json


def graded_run(
    root: Path, name: str, values: Sequence[float | None], *, scenario: str = "road", scenario_hash: str = "ab" * 32
) -> str:
    """A log that was graded by `default`, with values for METRICS; its path."""
    record = {"command": "grade", "log": "drive.log", "vehicle": "mkz_bywire", "path": scenario, "weights": "default"}
    run = RunFolder.create(root, name, record)
    metrics = {metric: {"value": value, "n": 100, "why": ""} for metric, value in zip(METRICS, values, strict=True)}
    data = {
        "scenario": scenario, "scenario_hash": scenario_hash, "score": 0.5, "replans": 0, "outcome": FINISHED,
        "planned_samples": 1000, "metrics": metrics,
    }  # fmt: skip
    write_json(run.path / "grade.json", data)
    save_recording(make_recording({"speed_mps": np.zeros(3)}, 0.01), run.episode(0) / "columns.npz")
    run.finish()
    return str(run.path)


def pairs_file(path: Path, entries: Sequence[Mapping[str, object]]) -> Path:
    """A file of pairs."""
    path.write_text(to_toml({"schema": "tunefree.pairs/1", "pairs": [dict(entry) for entry in entries]}))
    return path


def write_pairs(root: Path, rule: Sequence[float], n_groups: int, n_each: int = 3, seed: int = 1) -> Path:
    """Runs of random metrics, paired so that the human one has the lower sum of rule x metric; the file of pairs."""
    chance, entries = np.random.default_rng(seed), []
    for group in range(n_groups):
        scenario = f"road_{group}"
        for number in range(n_each):
            values = chance.uniform(0.0, 1.0, (2, len(METRICS)))
            values = values[np.argsort(values @ np.asarray(rule))]
            human, generated = (
                graded_run(root, f"{side}-{group}-{number}", row.tolist(), scenario=scenario)
                for side, row in zip(("human", "gains"), values, strict=True)
            )
            entries.append({"human": human, "generated": [generated], "group": scenario})
    return pairs_file(root / "pairs.toml", entries)
