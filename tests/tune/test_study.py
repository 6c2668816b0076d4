"""Slots, failures, resuming and what a study keeps (docs/reference/design.md)."""

from __future__ import annotations

import dataclasses
import json
import math
import shutil
import sqlite3
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import optuna
import pytest

from tests.tune.drive_study import FIRST, SPACE, Parameter, bowl, settings
from tests.tune.sampler_cases import CASES, INSTALLED
from tunefree_hil.base.errors import BenchError, InputError, PeerGone, TunefreeError
from tunefree_hil.tune.sampling import ScoredPoint, suggest_point
from tunefree_hil.tune.space import make_space
from tunefree_hil.tune.study import Evaluation, Study, Trial, open_study, read_study
from tunefree_hil.tune.trial_loop import run_trials, suggest_slots

Open = Callable[..., Study]


@pytest.fixture(scope="session")
def begun(tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, int], Path]:
    """Studies of 0 and 12 trials, to copy: making the tables takes Optuna half a second."""
    folder = tmp_path_factory.mktemp("begun")
    paths = {(sampler, 0): folder / f"{sampler}.db" for sampler in INSTALLED}
    for (sampler, _), path in paths.items():
        open_study(path, settings(sampler)).close()
    paths["tpe_independent", 12] = Path(shutil.copy(paths["tpe_independent", 0], folder / "later.db"))
    with open_study(folder / "later.db", settings("tpe_independent")) as study:
        list(run_trials(study, 12, bowl))
    return paths


@pytest.fixture
def opened(tmp_path: Path, begun: dict[tuple[str, int], Path]) -> Iterator[Open]:
    """open(sampler, trials done) -> the study in tmp_path; all are closed at the end."""
    studies: list[Study] = []

    def open_(sampler: str = "tpe_independent", done: int = 0) -> Study:
        path = tmp_path / "study.db"
        if not path.exists():
            shutil.copy(begun[sampler, done], path)
        studies.append(open_study(path, settings(sampler)))
        return studies[-1]

    yield open_
    for study in studies:
        study.close()


def course(trials: int, sampler: str = "tpe_independent") -> list[tuple[int, dict[str, float], float, dict[str, Any]]]:
    """What a study that nothing disturbs must hold, worked out without a file."""
    found = []
    for slot in range(trials):
        history = [ScoredPoint(values, score) for _, values, score, _ in found]
        values = suggest_point(SPACE, history, sampler=sampler, seed=3, slot=slot) if slot else FIRST
        found.append((slot, values, *bowl(values)[:2]))
    return found


def facts(trials: list[Trial]) -> list[tuple[int, dict[str, float], float, dict[str, object]]]:
    """A trial without Optuna's number, which a kill shifts."""
    return [(trial.slot, trial.parameters, trial.score, trial.scenarios) for trial in trials]


@dataclasses.dataclass
class Troubled:
    """An evaluation that raises `trouble` at the given calls (counted from 0)."""

    trouble: BaseException
    at: tuple[int, ...]
    calls: int = 0

    def __call__(self, parameters: dict[str, float]) -> Evaluation:
        self.calls += 1
        if self.calls - 1 in self.at:
            raise self.trouble
        return bowl(parameters)


@pytest.mark.parametrize("sampler", CASES)
def test_a_study_fills_its_slots(opened: Open, sampler: str) -> None:
    study = opened(sampler)
    yielded = list(run_trials(study, 14, bowl))
    assert [trial.slot for trial in yielded] == list(range(14))
    assert yielded == study.trials()
    assert facts(yielded) == course(14, sampler)
    assert all(SPACE.clip(trial.parameters) == trial.parameters for trial in yielded)
    assert study.best() == min(yielded, key=lambda trial: trial.score)
    assert list(run_trials(study, 14, bowl)) == []


def test_the_file_holds_raw_score_and_its_logarithm(opened: Open) -> None:
    study = opened()
    list(run_trials(study, 3, bowl))
    stored = optuna.load_study(study_name=None, storage=f"sqlite:///{study.path}")
    for frozen, trial in zip(stored.trials, study.trials(), strict=True):
        assert frozen.user_attrs["score"] == trial.score
        assert frozen.value == math.log(trial.score)
        assert frozen.user_attrs["slot"] == trial.slot
        assert frozen.params == trial.parameters
    stored._storage.remove_session()


@pytest.mark.parametrize("trouble", [KeyboardInterrupt(), ZeroDivisionError()])
@pytest.mark.parametrize("sampler", CASES)
def test_an_interrupted_study_goes_on_where_it_was(opened: Open, sampler: str, trouble: BaseException) -> None:
    study = opened(sampler)
    for at in (0, 3, 9):
        with pytest.raises(type(trouble)):
            list(run_trials(study, 14, Troubled(trouble, (at,))))
    assert {trial.error for trial in study.failures()} == {"interrupted"}
    list(run_trials(study, 14, bowl))
    assert facts(study.trials()) == course(14, sampler)
    assert [trial.slot for trial in study.failures()] == [0, 3, 12]
    assert study.trials()[-1].number == 13 + 3


@pytest.mark.parametrize("stage", ["waiting", "running", "half asked", "scored"])
def test_what_a_kill_leaves_behind_is_told_fail(opened: Open, stage: str) -> None:
    cut = opened(done=12)
    asked_for = suggest_slots(cut.settings, cut.trials(), [12])[12]
    cut.stored.optuna_study.enqueue_trial(asked_for, user_attrs={"slot": 12})
    if stage != "waiting":
        few = dict(list(cut.stored.distributions.items())[:2]) if stage == "half asked" else cut.stored.distributions
        asked = cut.stored.optuna_study.ask(few)
        if stage == "scored":
            asked.set_user_attr("score", 0.0)
    list(run_trials(opened(), 14, bowl))
    assert facts(cut.trials()) == course(14)
    assert [(trial.slot, trial.error) for trial in cut.failures()] == [(12, "interrupted")]


def test_stopping_to_listen_leaves_nothing_running(opened: Open) -> None:
    study = opened()
    for trial in run_trials(study, 10, bowl):
        if trial.slot == 2:
            break
    assert len(study.trials()) == 3
    assert study.failures() == []
    assert [trial.slot for trial in run_trials(study, 5, bowl)] == [3, 4]


@pytest.mark.parametrize("times", [1, 2])
def test_a_lost_node_is_told_by_name_and_the_slot_asked_again(opened: Open, times: int) -> None:
    study = opened(done=12)
    yielded = list(run_trials(study, 14, Troubled(PeerGone("ecu"), tuple(range(times)))))
    failed = [trial for trial in yielded if trial.error]
    assert [trial.slot for trial in failed] == [12] * times
    assert all("ecu is gone" in trial.error and math.isnan(trial.score) for trial in failed)
    assert [trial._replace(score=0.0) for trial in study.failures()] == [trial._replace(score=0.0) for trial in failed]
    assert facts(study.trials()) == course(14)


def test_a_node_lost_three_times_ends_the_run_but_not_the_study(opened: Open) -> None:
    study = opened(done=12)
    lost = Troubled(PeerGone("ecu"), tuple(range(1, 99)))
    yielded = []
    with pytest.raises(PeerGone) as caught:
        for trial in run_trials(study, 14, lost):
            yielded.append(trial)
    assert caught.value.peer == "ecu"
    assert [trial.slot for trial in yielded if trial.error] == [13, 13, 13]
    assert len(study.trials()) == 13
    list(run_trials(study, 14, bowl))
    assert facts(study.trials()) == course(14)


def test_an_evaluation_may_say_that_the_bench_failed(opened: Open) -> None:
    study = opened()
    answers = iter([Evaluation(0.0, {}, error="controller does not answer"), bowl(FIRST)])
    failed, filled = run_trials(study, 1, lambda _: next(answers))
    assert "controller does not answer" in failed.error
    assert filled.score == bowl(FIRST).score
    with pytest.raises(BenchError, match="no answer"):
        list(run_trials(study, 2, lambda _: Evaluation(0.0, {}, error="no answer")))


@pytest.mark.parametrize("score", [math.nan, math.inf, -0.1])
def test_a_score_that_is_none_ends_the_run_at_once(opened: Open, score: float) -> None:
    study = opened()
    with pytest.raises(TunefreeError, match="slot 0 was scored"):
        list(run_trials(study, 3, lambda _: Evaluation(score, {})))
    assert [trial.slot for trial in study.failures()] == [0]
    with pytest.raises(TunefreeError, match="baseline manual"):
        study.add_baseline("manual", {}, Evaluation(score, {}))


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"seed": 4}, "seed was 3, now 4"),
        ({"sampler": "random"}, "sampler was tpe_independent, now random"),
        ({"bench_hash": "sha256:01"}, "bench_hash was sha256:00, now sha256:01"),
        ({"first": {**FIRST, "lqr.q1": 0.5}}, "first lqr.q1 was 0.05, now 0.5"),
        ({"first": {}}, "first were"),
    ],
)
def test_other_settings_are_refused_by_name(opened: Open, change: dict[str, object], word: str) -> None:
    study = opened()
    list(run_trials(study, 2, bowl))
    with pytest.raises(InputError, match=word) as caught:
        open_study(study.path, settings("tpe_independent")._replace(**change))
    assert caught.value.exit_status == 2
    assert caught.value.key == next(iter(change)) + (" lqr.q1" if change.get("first") else "")
    assert len(opened().trials()) == 2


def test_another_box_is_refused_by_name(opened: Open) -> None:
    path = opened().path
    axes = (SPACE.axes[0]._replace(high=0.5), *SPACE.axes[1:])
    with pytest.raises(InputError, match=r"q1 was 0\.01 to 1 log, now"):
        open_study(path, settings("tpe_independent")._replace(space=SPACE._replace(axes=axes)))
    fewer = make_space([Parameter("lqr.q1", 0.01, 1.0)])
    with pytest.raises(InputError, match=r"parameters were lqr\.q1, station\.kp"):
        open_study(path, settings("tpe_independent")._replace(space=fewer, first=fewer.clip(FIRST)))


@pytest.mark.parametrize("change", [{"seed": -1}, {"sampler": "gp"}, {"first": {**FIRST, "lqr.q1": 0.0}}])
def test_settings_that_no_study_can_have(tmp_path: Path, change: dict[str, object]) -> None:
    with pytest.raises(InputError):
        open_study(tmp_path / "study.db", settings("random")._replace(**change))
    assert list(tmp_path.iterdir()) == []


def test_read_study_knows_what_was_asked(opened: Open) -> None:
    list(run_trials(opened(), 3, bowl))
    with read_study(opened().path) as study:
        assert study.settings == settings("tpe_independent")
        assert study.stored.versions == (optuna.__version__,)
        assert len(study.trials()) == 3


def test_baselines_are_stored_but_not_learned_from(opened: Open) -> None:
    study = opened(done=12)
    values = {**FIRST, "mrac.enable": 0.0, "lqr.q2": 0.0}
    study.add_baseline("as_shipped", values, bowl(FIRST))
    list(run_trials(study, 13, bowl))
    assert facts(study.trials()) == course(13)
    with read_study(study.path) as again:
        assert again.baselines() == study.baselines()
        assert again.baselines()["as_shipped"].parameters == values
        assert again.baselines()["as_shipped"].score == bowl(FIRST).score


def test_two_processes_cannot_fill_one_study(opened: Open) -> None:
    first = run_trials(opened(), 5, bowl)
    next(first)
    with pytest.raises(InputError, match="another process"):
        next(run_trials(opened(), 5, bowl))
    first.close()
    assert len(list(run_trials(opened(), 5, bowl))) == 4


def test_a_creation_that_was_cut_off_is_made_anew(tmp_path: Path) -> None:
    (tmp_path / "study.db.part").write_bytes(b"half a file")
    with open_study(tmp_path / "study.db", settings("random")) as study:
        assert len(list(run_trials(study, 2, bowl))) == 2
    assert not (tmp_path / "study.db.part").exists()


def test_what_is_no_study_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "study.db"
    with pytest.raises(InputError, match="no study"):
        read_study(path)
    path.write_text("no database at all, but long enough to be taken for the header of one" * 20)
    with pytest.raises(InputError, match="not an Optuna study"):
        read_study(path)
    path.unlink()
    other = sqlite3.connect(path)
    other.execute("CREATE TABLE mine (x)")
    other.close()
    before = path.read_bytes()
    with pytest.raises(InputError, match="not an Optuna study"):
        read_study(path)
    assert path.read_bytes() == before


def test_scenarios_are_kept_as_they_are(opened: Open) -> None:
    scenarios = {"left_turn": {"score": 0.1 + 0.2, "metrics": {"lateral_err_peak": None}, "errors": ["left_lane"]}}
    study = opened()
    list(run_trials(study, 1, lambda _: Evaluation(0.3, scenarios)))
    assert study.trials()[0].scenarios == json.loads(json.dumps(scenarios)) == scenarios
