"""`explain`: the difference adds up, edges are flagged, slices change one value at a time (a fake batch drives)."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from tests.bench.tiny import write_bench
from tests.jobs.made_runs import made_drive, made_tune
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import load
from tunefree_hil.grade.score import FINISHED, ScenarioGrade
from tunefree_hil.jobs.options.records import ExplainOptions
from tunefree_hil.jobs.run_folder import open_run
from tunefree_hil.jobs.tune import explain as job
from tunefree_hil.tune.study import read_study


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tune of 25 trials over two short scenarios."""
    folder = tmp_path_factory.mktemp("tuned")
    bench = write_bench(folder, scenarios=("tiny", "other"), duration_s=0.5)
    return made_tune(bench, folder / "runs", 25)


class Driven(NamedTuple):
    grade: ScenarioGrade | None


class FakeBatch:
    """Scores by formula; `seen`: the vectors it got, `failing`: a value of mrac.p at which the bench fails."""

    seen: list[dict[str, float]] = []  # noqa: RUF012 - one a test
    failing = -1.0

    def __init__(self, bench: Any, model: str) -> None:
        assert model == bench.spec.model

    def __enter__(self) -> FakeBatch:
        return self

    def __exit__(self, *error: object) -> None:
        return None

    def drive(self, jobs: Sequence[Any]) -> list[Driven]:
        FakeBatch.seen = [dict(one.values) for one in jobs]
        return [Driven(self._grade(one)) for one in jobs]

    def _grade(self, one: Any) -> ScenarioGrade | None:
        if one.values["mrac.p"] == self.failing:
            return None
        score = abs(math.log(one.values["mrac.t_ref_s"]))
        return ScenarioGrade(one.scenario.name, score, {}, 0, FINISHED, 100)


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> type[FakeBatch]:
    monkeypatch.setattr(job, "Batch", FakeBatch)
    monkeypatch.setattr(FakeBatch, "failing", -1.0)
    return FakeBatch


def test_the_difference_adds_up_to_the_scores(run: Path) -> None:
    *_, last = job.explain(ExplainOptions(run, points=5, slices=False))
    data = last.data
    with read_study(run / "study.db") as study:
        best, baselines = study.best(), study.baselines()
    assert best is not None
    manual = min(one.score for one in baselines.values())
    assert data["manual"]["score"] == manual and data["winner"]["slot"] == best.slot
    cells = math.fsum(value for row in data["difference"]["terms"].values() for value in row.values())
    assert cells == pytest.approx(data["difference"]["total"], abs=1e-15)
    stored = json.loads((run / "explain.json").read_text())
    assert stored["difference"] == data["difference"] and stored["slices"] == {}
    assert {Path(figure).name for figure in data["figures"]} == {"difference.png", "importance.png"}
    assert [one["n"] for one in data["importance"].values()] == [25, 25]


def test_slices_change_one_value_at_a_time(run: Path, fake: type[FakeBatch]) -> None:
    events = list(job.explain(ExplainOptions(run, points=5)))
    data = events[-1].data
    winner = data["winner"]["parameters"]
    vectors = fake.seen[::2]
    assert len(vectors) == 1 + 5 + 5 and fake.seen[::2] == fake.seen[1::2]
    for vector in vectors:
        assert sum(vector[name] != value for name, value in winner.items()) <= 1
    curve = data["slices"]["mrac.t_ref_s"]
    assert curve["scores"] == pytest.approx([abs(math.log(value)) for value in curve["values"]])
    flat = data["slices"]["mrac.p"]["scores"]
    assert flat == pytest.approx([abs(math.log(winner["mrac.t_ref_s"]))] * 5)
    assert any(event.kind == "warning" and "in the batch, " in event.message for event in events)
    assert (run / "figures" / "slices.png").stat().st_size > 10_000


FAULT = """[[faults]]
kind = "drop"
message = "STEERING_CMD"
from_tick = 1
to_tick = 2
"""


@pytest.mark.parametrize(
    ("more", "joined", "words"),
    [
        ('[controller]\ncommand = ["./pursuit"]', None, "only our controller, not ./pursuit"),
        ("", "pursuit", "not pursuit, which was joined"),
        (FAULT, None, "faults of the bench file (drop)"),
    ],
)
def test_what_no_batch_drives_has_no_slices_and_the_reason(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, more: str, joined: str | None, words: str
) -> None:
    monkeypatch.setattr(job, "Batch", lambda *_: pytest.fail("it would drive our controller on a whole bus"))
    other = Path(shutil.copytree(run, tmp_path / "run"))
    shutil.copytree(run.parents[1] / "scenarios", tmp_path / "run" / "scenarios")
    (other / "bench.toml").write_text(write_bench(tmp_path / "b", scenarios=("tiny", "other"), more=more).read_text())
    folder = open_run(other)
    folder.add_to_record(joined=joined)
    *events, last = job.explain(ExplainOptions(other, points=5))
    (warning,) = [event.message for event in events if event.kind == "warning"]
    assert warning.startswith("no slices through the winner: ") and words in warning
    assert last.data["slices"] == {} and "better point" not in last.message


def test_a_drive_that_the_bench_failed_is_a_gap(run: Path, fake: type[FakeBatch], monkeypatch: Any) -> None:
    bench = load(run / "bench.toml")
    found = job.analyse_study(job.open_run(run), bench)
    monkeypatch.setattr(fake, "failing", found.space.axes[1].low)
    slices, _ = job.drive_slices(bench, found.space, found.winner.parameters, 3)
    assert [score is None for score in slices["mrac.p"].scores] == [True, False, False]


def test_a_winner_on_an_edge_is_flagged_in_words(run: Path) -> None:
    found = job.analyse_study(job.open_run(run), load(run / "bench.toml"))
    axis = found.space.axes[0]
    moved = found._replace(edges=job.describe_edges(found.space, {**found.winner.parameters, axis.name: axis.low}))
    assert f"{axis.name} is at the lower edge of its range" in job.summarise_analysis(moved)
    assert any("is at the lower edge" in line for line in job.format_analysis(moved))


def test_a_slice_that_beats_the_winner_is_said() -> None:
    slices = {
        "a": job.SliceScores([1.0, 2.0, 3.0], [0.3, 0.19, 0.25]),
        "b": job.SliceScores([1.0, 2.0], [0.1999, 0.4]),
        "c": job.SliceScores([1.0, 2.0], [None, 0.1]),
        "d": job.SliceScores([1.0], [None]),
    }
    assert job.find_better_points(slices, 0.2) == [("c", 2.0, 0.1), ("a", 2.0, 0.19)], "0.05 % is no better place"
    lines = job.format_slices(slices, 0.2)[1:]
    assert [("better" in line) for line in lines] == [True, False, True, False]
    assert "0.1900 to 0.3000, lowest at 2" in lines[0] and "failed everywhere" in lines[3]
    assert job.find_better_points({}, 0.2) == []


def test_a_winner_that_is_the_manual_one(run: Path) -> None:
    found = job.analyse_study(job.open_run(run), load(run / "bench.toml"))
    same = found._replace(
        difference=job.score_difference(
            found.manual.scenarios, found.manual.scenarios, load(run / "bench.toml").weights
        )
    )
    assert job.summarise_analysis(same).startswith(f"the winner has the scores of {found.manual_name} in every term")


def test_a_winner_that_is_worse_is_said_to_be(run: Path) -> None:
    found = job.analyse_study(job.open_run(run), load(run / "bench.toml"))
    terms = {"tiny": {"a": 0.3, "b": -0.2}}
    words = job.summarise_analysis(found._replace(difference=job.ScoreDifference(terms, {"tiny": 0.1}, 0.1), edges=[]))
    assert words.endswith("it is worse, mostly by a in tiny (+0.300)")
    better = {"tiny": {"a": 0.1, "b": -0.2}}
    words = job.summarise_analysis(
        found._replace(difference=job.ScoreDifference(better, {"tiny": -0.1}, -0.1), edges=[])
    )
    assert words.endswith(f"against {found.manual_name}, mostly by b in tiny (-0.200)")


def test_what_is_no_tune_or_not_finished(run: Path, tmp_path: Path) -> None:
    drive = made_drive(write_bench(tmp_path, duration_s=0.5), tmp_path / "runs", "d", {})
    with pytest.raises(InputError, match="is a run of 'drive'"):
        list(job.explain(ExplainOptions(drive, slices=False)))
    unfinished = tmp_path / "u"
    unfinished.mkdir()
    (unfinished / "run.json").write_text((run / "run.json").read_text())
    (unfinished / "bench.toml").write_text((run / "bench.toml").read_text())
    with pytest.raises(InputError, match="not finished"):
        list(job.explain(ExplainOptions(unfinished, slices=False)))
