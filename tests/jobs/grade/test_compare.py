"""`compare`: the same numbers as the drives' own, only common scenarios, conditions that decide the exit status."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from tests.bench.tiny import write_bench
from tests.jobs.made_runs import made_drive, made_tune
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.grade.profile import MetricValue, combine_values
from tunefree_hil.grade.score import SCORE_METRICS
from tunefree_hil.grade.table import PUBLISHED
from tunefree_hil.jobs.grade.compare import COMBINED, change_text, compare
from tunefree_hil.jobs.grade.grade import grade_log
from tunefree_hil.jobs.options.records import CompareOptions, GradeOptions


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("runs")


@pytest.fixture(scope="module")
def runs(folder: Path) -> list[str]:
    """Two drives of two scenarios, and one of the first scenario only."""
    bench = write_bench(folder, scenarios=("tiny", "other"), duration_s=1.5)
    return [
        str(made_drive(bench, folder / "runs", "first", {})),
        str(made_drive(bench, folder / "runs", "second", {"lqr.q1": 0.3, "mrac.enable": 0.0})),
        str(made_drive(bench, folder / "runs", "short", {}, last=1)),
    ]


@pytest.fixture(autouse=True)
def _no_figures(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures cost more than all the rest; the tests that want them say "draws" in their names."""
    if "draws" not in request.node.name:
        for module in ("compare", "grade"):
            monkeypatch.setattr(f"tunefree_hil.jobs.grade.{module}._figures", lambda *_: [])


def compared(runs: list[str], out: Path, *conditions: str) -> tuple[list[Event], dict[str, Any]]:
    events = list(compare(CompareOptions(runs, conditions, out=out)))
    return events, events[-1].data


def stored(run: str, number: int) -> dict[str, Any]:
    return json.loads((Path(run) / "episodes" / str(number) / "episode.json").read_text())


@pytest.mark.slow
def test_the_table_holds_what_the_drives_scored_and_draws(runs: list[str], tmp_path: Path) -> None:
    events, data = compared(runs[:2], tmp_path)
    assert data["exit"] == 0 and data["runs"] == ["first", "second"] and data["scenarios"] == ["tiny", "other"]
    for number, name in enumerate(data["scenarios"]):
        table = data["tables"][name]
        assert set(PUBLISHED) < set(table)
        for column, run in enumerate(runs[:2]):
            own = stored(run, number)
            assert table["score"][column] == own["score"]
            assert {metric: table[metric][column] for metric in SCORE_METRICS} == own["metrics"]
    pooled = data["tables"][COMBINED]["lateral_err_std"][0]
    parts = [MetricValue(data["tables"][name]["lateral_err_std"][0], 150) for name in data["scenarios"]]
    assert pooled == pytest.approx(combine_values("std", parts).value)
    assert all(Path(figure).stat().st_size > 10_000 for figure in data["figures"])
    assert {Path(figure).stem for figure in data["figures"]} >= {"highlights", "profile", "tiny", "other"}
    text = "\n".join(event.message for event in events if event.kind == "line")
    assert "combined:" in text and "-- effort" in text and (" better -" in text or " worse +" in text)
    assert json.loads((Path(data["run"]) / "compare.json").read_text())["tables"] == data["tables"]


def test_a_run_against_itself_is_equal(runs: list[str], tmp_path: Path) -> None:
    _, data = compared([runs[0], runs[0]], tmp_path, "score > +0%", "lateral_err_peak@tiny > +5%")
    assert data["exit"] == 0 and data["runs"] == ["first (1)", "first (2)"]
    assert all(first == other for table in data["tables"].values() for first, other in table.values())


def test_conditions_decide_the_exit_status(runs: list[str], tmp_path: Path) -> None:
    _, data = compared(runs[:2], tmp_path, "score > 0", "score@other > 9", "station_err_std_harsh > +5%")
    assert data["exit"] == 1
    assert [one["holds"] for one in data["findings"]] == [True, False, True]
    assert "is not available" in data["findings"][2]["words"], "a missing value must not pass"
    with pytest.raises(InputError, match="unknown metric"):
        compared(runs[:2], tmp_path, "score > 0", "lateral > 1")


def test_only_common_scenarios(runs: list[str], tmp_path: Path) -> None:
    events, data = compared([runs[0], runs[2]], tmp_path)
    assert data["scenarios"] == ["tiny"] and data["notes"] == ["other is left out: not driven in short"]
    assert [event.message for event in events if event.kind == "warning"] == data["notes"]


def test_no_common_scenario(runs: list[str], tmp_path: Path) -> None:
    bench = write_bench(tmp_path, scenarios=("third",), duration_s=0.5)
    third = made_drive(bench, tmp_path / "runs", "third", {})
    with pytest.raises(InputError, match="no common scenario"):
        compared([runs[0], str(third)], tmp_path)
    with pytest.raises(InputError, match="at least two runs"):
        compared(runs[:1], tmp_path)


def test_another_file_of_the_same_name_is_another_scenario(runs: list[str], tmp_path: Path) -> None:
    bench = write_bench(tmp_path, scenarios=("tiny",), duration_s=0.5)
    other = made_drive(bench, tmp_path / "runs", "other", {})
    with pytest.raises(InputError, match="different files of that name"):
        compared([runs[0], str(other)], tmp_path)


@pytest.mark.slow
def test_winner_and_baselines_of_a_tune(folder: Path, runs: list[str], tmp_path: Path) -> None:
    tune = str(made_tune(Path(folder / "b.toml"), tmp_path / "runs", 3))
    _, data = compared([f"{tune}:mrac_on", tune, f"{tune}:tuned"], tmp_path)
    assert data["runs"] == ["tune:mrac_on", "tune", "tune:tuned"]
    scores = data["tables"]["tiny"]["score"]
    assert scores[1] == scores[2] == stored(tune, 198)["score"]
    with pytest.raises(InputError, match="no candidate 'nobody'"):
        compared([tune, f"{tune}:nobody"], tmp_path)


def test_a_graded_log_beside_a_drive(folder: Path, runs: list[str], tmp_path: Path) -> None:
    log, path = Path(runs[0]) / "episodes" / "0" / "vehicle.log", str(folder / "scenarios" / "tiny.toml")
    *_, last = grade_log(log, GradeOptions(path=path, out=tmp_path))
    _, data = compared([runs[2], last.data["run"]], tmp_path)
    assert all(first == other for first, other in data["tables"]["tiny"].values())


def test_another_plant_or_vehicle_is_said(runs: list[str], tmp_path: Path) -> None:
    run = Path(shutil.copytree(runs[2], tmp_path / "run"))
    record = json.loads((run / "run.json").read_text())
    (run / "run.json").write_text(json.dumps({**record, "model": "mkz_reference"}))
    _, data = compared([runs[2], str(run)], tmp_path)
    assert [note for note in data["notes"] if "not the same model: " in note and "run mkz_reference" in note]
    assert not any("not the same vehicle" in note for note in data["notes"])


def test_a_run_without_drives(runs: list[str], tmp_path: Path) -> None:
    _, data = compared(runs[:2], tmp_path)
    with pytest.raises(InputError, match="is a run of 'compare'"):
        compared([runs[0], data["run"]], tmp_path)


def test_what_is_not_there_is_named(runs: list[str], tmp_path: Path) -> None:
    run = Path(shutil.copytree(runs[2], tmp_path / "run"))
    (run / "episodes" / "0" / "columns.npz").unlink()
    with pytest.raises(InputError, match="no drive with its columns"):
        compared([runs[0], str(run)], tmp_path)


@pytest.mark.parametrize(
    ("first", "other", "words"),
    [
        (1.0, 0.9, "better -10.0 %"),
        (1.0, 1.1, "worse +10.0 %"),
        (1.0, 1.0, "equal"),
        (1.0, 1.0001, "about equal"),
        (0.0, 0.1, "worse"),
        (None, 1.0, "not comparable"),
        (None, None, "not available in both"),
    ],
)
def test_words(first: float | None, other: float | None, words: str) -> None:
    assert change_text(first, other) == words
