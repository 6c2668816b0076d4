"""A winner that was not the best grade has lost its logs: it is driven again, and what it then scores is compared."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.bench.tiny import write_bench
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bench import parameters_of
from tunefree_hil.bus.bench_channel import HelloCollector, Role, hello_messages
from tunefree_hil.jobs.options.records import TuneOptions
from tunefree_hil.jobs.run_folder import RunFolder
from tunefree_hil.jobs.tune import tune
from tunefree_hil.jobs.tune.evaluators import VectorCandidate
from tunefree_hil.jobs.tune.options import TunePlan, make_tune_plan
from tunefree_hil.tune.trial import Evaluation, Trial

WINNER = Trial(4, 4, {"mrac.t_ref_s": 0.1, "mrac.p": 0.001}, 0.25, {})


class OneBench:
    """Stands in for a bench over the bus."""

    def __init__(self, score: float) -> None:
        self.score, self.asked = score, list[VectorCandidate]()

    def evaluate(self, candidates: Sequence[VectorCandidate]) -> list[Evaluation]:
        self.asked += candidates
        return [Evaluation(self.score, {}) for _ in candidates]


def driven_again(
    monkeypatch: pytest.MonkeyPatch, wish: TunePlan, folder: Path, score: float
) -> tuple[list[VectorCandidate], list[Event]]:
    bench = OneBench(score)

    @contextmanager
    def on_lanes(*_: Any) -> Iterator[OneBench]:
        yield bench

    monkeypatch.setattr(tune, "_open_evaluator", on_lanes)
    said = list(tune._redrive_winner(wish, RunFolder(folder, {}), WINNER))
    return bench.asked, said


def wish_of(folder: Path, **more: Any) -> TunePlan:
    return make_tune_plan(TuneOptions(write_bench(folder), **more))


def test_it_is_driven_again_in_its_own_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    wish = wish_of(tmp_path)
    asked, said = driven_again(monkeypatch, wish, tmp_path, WINNER.score)
    (one,) = asked
    assert one.group == len(wish.vectors) + WINNER.slot
    assert one.values == parameters_of(wish.bench, WINNER.parameters)
    assert [event.kind for event in said] == ["note"] and "trial 5 wins" in said[0].message


def test_another_score_than_the_study_s_is_a_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _, said = driven_again(monkeypatch, wish_of(tmp_path), tmp_path, 0.5)
    assert [event.kind for event in said] == ["note", "warning"] and "0.5" in said[1].message


def test_a_winner_whose_drives_are_there_is_not_driven(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    wish, run = wish_of(tmp_path), RunFolder(tmp_path, {})
    folder = run.episode(len(wish.vectors) + WINNER.slot)
    folder.mkdir(parents=True, exist_ok=True)
    np.savez(folder / "columns.npz", time_s=np.zeros(2))
    assert driven_again(monkeypatch, wish, tmp_path, 0.5) == ([], [])
    joined = wish._replace(options=wish.options._replace(join=True))
    assert driven_again(monkeypatch, joined, tmp_path / "other", 0.5) == ([], []), "that bench has ended"


@pytest.mark.parametrize("join", [True, False])
def test_what_a_joined_controller_calls_itself_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, join: bool
) -> None:
    """What drives the same car once more without the bus asks for it (`why_not`)."""
    heard = HelloCollector()
    for message in hello_messages(Role.CONTROLLER, "pursuit"):
        heard.add(message)

    @contextmanager
    def open_lanes(*_: Any, **__: Any) -> Iterator[list[Any]]:
        yield [SimpleNamespace(runner=SimpleNamespace(collector=heard, stop=lambda: None))]

    monkeypatch.setattr(tune, "open_lanes", open_lanes)
    run = RunFolder(tmp_path, {})
    with tune._open_evaluator(wish_of(tmp_path, join=join), run):
        pass
    assert run.record.get("joined") == ("pursuit" if join else None)


@pytest.mark.parametrize(("join", "other"), [(True, True), (True, False), (False, True)])
def test_nothing_is_verified_on_a_joined_ecu_that_drives_another_car(tmp_path: Path, join: bool, other: bool) -> None:
    bench = write_bench(tmp_path)
    if other:
        bench.write_text(bench.read_text().replace('verify_model = "mkz_nominal"', 'verify_model = "mkz_reference"'))
    wish = make_tune_plan(TuneOptions(bench, join=join, session="s", verify=True))
    assert tune._is_verified(wish) == (not (join and other))
    words = tune._not_verified_text(wish, RunFolder(tmp_path / "run", {}))
    assert f"ecu {tmp_path}/run/bench.toml --model {wish.bench.spec.verify_model} --session s" in words
    assert f"verify {tmp_path}/run --join --session s" in words


@pytest.mark.parametrize("slower", ["0.9", "11.0", "nan"])
def test_a_factor_that_does_not_do_is_refused(tmp_path: Path, slower: str) -> None:
    bench = write_bench(tmp_path)
    bench.write_text(bench.read_text().replace("slower = 1.0", f"slower = {slower}"))
    with pytest.raises(InputError) as refused:
        make_tune_plan(TuneOptions(bench))
    assert refused.value.key == "tune.slower" and refused.value.file == str(bench)
