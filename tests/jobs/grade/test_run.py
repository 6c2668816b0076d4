"""`grade RUN`: the drives taken together, as their own logs are graded one by one; and which way a name is read."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from tests.bench.tiny import write_bench
from tests.jobs.made_runs import made_drive, made_tune
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.grade.table import TABLE
from tunefree_hil.jobs.grade.run import grade_any, is_run
from tunefree_hil.jobs.options.records import GradeOptions

NOTHING: dict[str, Any] = {
    "vehicle": None,
    "path": None,
    "align": "auto",
    "start_s": None,
    "weights": None,
    "out": None,
}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive of two scenarios."""
    folder = tmp_path_factory.mktemp("runs")
    bench = write_bench(folder, scenarios=("tiny", "other"), duration_s=1.5)
    return made_drive(bench, folder / "runs", "a", {})


@pytest.fixture(autouse=True)
def _no_figures(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures cost more than all the rest; the tests that want them say "draws" in their names."""
    if "draws" not in request.node.name:
        monkeypatch.setattr("tunefree_hil.jobs.grade.grade._figures", lambda *_: [])
        monkeypatch.setattr("tunefree_hil.jobs.grade.run._figure", lambda *_: "")


def graded(name: object, **more: Any) -> tuple[list[Event], dict[str, Any]]:
    events = list(grade_any(str(name), GradeOptions(**{**NOTHING, **more})))
    return events, events[-1].data


def test_a_run_is_its_logs_taken_together(run: Path, tmp_path: Path) -> None:
    events, data = graded(run)
    logs = [graded(run / "episodes" / str(k), out=tmp_path)[1] for k in range(2)]
    assert list(data["scenarios"]) == ["tiny", "other"] == [log["scenario"] for log in logs]
    assert data["score"] == pytest.approx(math.fsum(log["score"] for log in logs) / 2.0), "of equal length"
    for name, row in TABLE.items():
        parts = [(log["metrics"][name]["value"], log["metrics"][name]["n"]) for log in logs]
        known = [(value, n) for value, n in parts if value is not None]
        value, total = data["metrics"][name]["value"], sum(n for _, n in known)
        if not known:
            assert value is None and data["metrics"][name]["why"], name
        elif row.aggregation == "peak":
            assert value == max(value for value, _ in known), name
        elif row.aggregation == "std":
            assert value == pytest.approx(math.sqrt(sum(v * v * (n - 1) for v, n in known) / (total - 1))), name
        else:
            assert value == pytest.approx(sum(v * n for v, n in known) / total), name
    assert json.loads((run / "grade.json").read_text())["metrics"] == data["metrics"]
    said = [event.message for event in events if event.kind == "line"]
    assert any(line.split()[:1] == ["other"] and "finished, 0 re-plans" in line for line in said)


@pytest.mark.slow
def test_a_tune_its_baselines_and_draws(tmp_path: Path) -> None:
    tune = made_tune(write_bench(tmp_path, duration_s=1.0), tmp_path / "runs", 3)
    _, winner = graded(tune)
    _, manual = graded(f"{tune}:mrac_on")
    assert {"grade.json", "grade-mrac_on.json"} <= {path.name for path in tune.iterdir()}
    assert {"profile.png", "profile-mrac_on.png"} <= {path.name for path in (tune / "figures").iterdir()}
    assert winner["weights"] == manual["weights"] == "default"
    assert graded(tune, weights="paper")[1]["weights"] == "paper"
    with pytest.raises(InputError, match="no candidate"):
        graded(f"{tune}:nobody")


def test_what_a_run_knows_cannot_be_given(run: Path) -> None:
    for key, value in (("path", "u_turn"), ("vehicle", "mkz_bywire"), ("start_s", 1.0), ("out", Path("x"))):
        with pytest.raises(InputError, match="not for a run") as caught:
            graded(run, **{key: value})
        assert caught.value.key == f"--{key.replace('_', '-')}"


def test_runs_and_logs_are_told_apart(run: Path) -> None:
    assert is_run(str(run)) and is_run(f"{run}:mrac_on") and is_run(str(run / "verify"))
    assert not is_run(str(run / "episodes" / "0")) and not is_run(str(run / "episodes" / "0" / "vehicle.log"))
    assert not is_run(str(run.parent)) and not is_run("nowhere.log")


def test_a_log_of_ours_knows_what_was_driven(run: Path, tmp_path: Path) -> None:
    _, data = graded(run / "episodes" / "1" / "vehicle.log", out=tmp_path)
    assert data["scenario"] == "other"
    away = tmp_path / "away.log"
    away.write_bytes((run / "episodes" / "1" / "vehicle.log").read_bytes())
    with pytest.raises(InputError, match="not known") as caught:
        graded(away)
    assert caught.value.key == "--path"
