"""The measures of learning: unseen drives on slopes of their own, and what is said of a card."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import tomli_w

from tests.figures.learning.test_training import judged
from tools.measures._unseen import GAINS, SCALED, _bench, ended, scaled
from tools.measures.freerun import card_words, reductions
from tunefree_hil.base.events import Event
from tunefree_hil.bench import load, parameters_of
from tunefree_hil.bench.controller import require_in_box
from tunefree_hil.config.load import load_model
from tunefree_hil.learn.model_folder import LearnedModel, write_learned_model


def test_an_unseen_bench_can_be_driven_and_stands_on_a_slope(repo: Path, tmp_path: Path) -> None:
    bench = load(repo / "bench_configs" / "mkz_complete.toml")
    names = [*bench.spec.scenarios, *bench.spec.verify_scenarios]
    file = tmp_path / "bench.toml"
    file.write_text(tomli_w.dumps(_bench(bench, names, 0.03)))
    own = load(file)
    assert own.spec.effects[0].params == {"grade_rad": 0.03} and own.spec.scenarios == names
    assert not _bench(bench, names, 0.0).get("effects")


@pytest.mark.parametrize("factor", GAINS)
def test_scaled_gains_stay_in_their_boxes(repo: Path, factor: float) -> None:
    values = parameters_of(load(repo / "bench_configs" / "mkz_complete.toml"))
    found = scaled(values, factor)
    assert set(found) == set(SCALED)
    for name, value in found.items():
        require_in_box(name, value)
    assert (found == {name: values[name] for name in SCALED}) == (factor == 1.0)


def test_a_jobs_result_is_what_counts() -> None:
    assert ended([Event("note", "a"), Event("result", "", {"run": "x"})]) == {"run": "x"}


def test_reductions_are_against_every_other_kind() -> None:
    some = {kind: judged(kind, factor) for kind, factor in (("hybrid", 0.4), ("physics", 1.0), ("mlp", 4.0))}
    found = reductions(some, 1)
    assert set(found) == {"level", "hills"} and set(found["level"]) == {"physics", "mlp"}
    assert found["level"]["physics"]["value"] == pytest.approx(60.0)
    assert found["hills"]["mlp"]["value"] == pytest.approx(90.0)


def test_a_card_in_words(repo: Path, tmp_path: Path) -> None:
    nominal = load_model(repo / "bench_configs" / "models" / "mkz_nominal")
    vehicle = load(repo / "bench_configs" / "mkz_complete.toml").vehicle
    card = {"split": "2 of 11", "seconds": 3.0, "training": {"steps": 5, "score": 1.0, "untrained": 2.0, "stopped": ""}}
    write_learned_model(tmp_path / "m", LearnedModel("physics", vehicle, nominal), card)
    assert card_words(load_model(tmp_path / "m"))["held_out"] == 1.0
    assert json.loads((tmp_path / "m" / "card.json").read_text())["split"] == "2 of 11"
