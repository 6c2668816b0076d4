"""The measure `margins`: what it reads of finished runs, and the one number that it makes of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.bench.tiny import write_bench
from tests.jobs.made_margins import made_margins
from tools.measures import margins as measure_margins
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bench import load
from tunefree_hil.jobs.run_folder import write_json
from tunefree_hil.jobs.tune.margins import MarginDrives


def run_with(folder: Path, margins: dict[str, Any]) -> Path:
    folder.mkdir(parents=True)
    write_json(folder / "verify.json", {"schema": "tunefree.verify/1", "margins": margins})
    return folder


def test_the_value_is_the_ratio_and_several_runs_give_a_range(tmp_path: Path) -> None:
    runs = [run_with(tmp_path / "a", made_margins()), run_with(tmp_path / "b", made_margins({"tuned": 0.22, "m": 0.1}))]
    answer = measure_margins.measure(runs=",".join(map(str, runs)), figures=str(tmp_path))
    assert answer["n"] == 2 and answer["low"] == pytest.approx(0.06 / 0.11) and answer["high"] == pytest.approx(2.2)
    detail = answer["detail"]["runs"][str(runs[0])]
    assert detail["against"] == "manual" and "less delay margin than manual: 60 ms against 110 ms" in detail["words"]
    assert Path(answer["detail"]["figure"]).is_file()


def test_without_anything_to_compare_there_is_no_number(tmp_path: Path) -> None:
    run = run_with(tmp_path / "a", made_margins({"tuned": 0.06, "manual": 0.0}))
    with pytest.raises(InputError, match="re-plans as it is"):
        measure_margins.measure(runs=str(run), figures=str(tmp_path))


def test_the_whole_score_is_weighted_by_planned_samples(tmp_path: Path) -> None:
    bench = load(write_bench(tmp_path, duration_s=2.0, scenarios=("tiny", "other")))
    found = MarginDrives({}, {}, {"tuned": {"tiny": 0.1, "other": 0.3}}, {}, 0)
    assert measure_margins.scores_of(bench, found) == {"tuned": pytest.approx(0.2)}


def test_own_runs_are_made_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def tune(wish: Any) -> Any:
        asked.append(wish)
        run = wish.out / f"run-{len(asked)}"
        run.mkdir(parents=True)
        (run / "best.toml").write_text("")
        yield Event("result", "done")

    monkeypatch.setattr(measure_margins, "tune", tune)
    first = measure_margins.own_runs("b.toml", 5, 2, tmp_path)
    assert measure_margins.own_runs("b.toml", 5, 2, tmp_path) == first and len(set(first)) == 2
    assert [(one.seed, one.trials, one.backend, one.verify) for one in asked] == [
        (1, 5, "batch", False),
        (2, 5, "batch", False),
    ]
