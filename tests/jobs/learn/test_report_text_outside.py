"""The share of a drive outside the model's valid region stands beside its result; learned models on a real bus."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from tests.bench.tiny import write_bench
from tests.jobs.command import Ended, tunefree_alone
from tests.plant.model_files import write_model
from tunefree_hil.bench import Bench, load
from tunefree_hil.episode.recording import Recording, make_recording
from tunefree_hil.jobs.learn.report_text import describe_outside, measure_outside, warn_of_outside

PATIENCE_S = 150.0
NARROW = "speed_mps = [0.0, 4.0]"


def narrow(folder: Path, kind: str) -> Path:
    """A learned model whose data went up to 4 m/s; the tiny bench drives 5 m/s."""
    model = write_model(folder, kind)
    path = model / "model.toml"
    text = path.read_text()
    assert "speed_mps = [0.0, 30.0]" in text
    path.write_text(text.replace("speed_mps = [0.0, 30.0]", NARROW))
    return model


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    found = load(write_bench(tmp_path))
    model = str(narrow(tmp_path / "narrow", "rule_based"))
    return replace(found, spec=msgspec.structs.replace(found.spec, model=model))


def at(speed_mps: float, ticks: int = 300) -> Recording:
    return make_recording({"speed_mps": np.full(ticks, speed_mps), "lateral_accel_mps2": np.zeros(ticks)}, 0.01)


def test_shares_of_drives_and_words(bench: Bench) -> None:
    model = bench.spec.model
    found = measure_outside(bench, model, {"slow": at(3.0), "fast": at(6.0, 100)})
    assert (found["share"], found["by"], found["drives"]) == (0.25, {"speed_mps": 0.25}, {"fast": 1.0})
    words = describe_outside(found)
    assert "25.0 % of the ticks outside the valid region" in words and "speed_mps 25.0 %" in words
    assert "100.0 %" in warn_of_outside(bench, model, "fast", at(6.0)) and "speed_mps" in warn_of_outside(
        bench, model, "fast", at(6.0)
    )
    assert warn_of_outside(bench, model, "slow", at(3.0)) == ""
    inside = measure_outside(bench, model, {"slow": at(3.0)})
    assert (inside["share"], inside["drives"]) == (0.0, {}) and "0.0 %" in describe_outside(inside)


def test_a_model_that_names_no_region_is_not_said_to_be_right(bench: Bench, tmp_path: Path) -> None:
    path = tmp_path / "narrow" / "model.toml"
    path.write_text(path.read_text().split("[valid]")[0])
    found = measure_outside(bench, bench.spec.model, {"slow": at(3.0)})
    assert found["share"] is None and describe_outside(found) == ""


def ended(command: str, bench: Path, *more: Any) -> Ended:
    """A command over real processes that went well; its runs lie beside the bench file."""
    words = (command, bench, *more, "--out", bench.parent / "runs", "--json")
    done = tunefree_alone(*words, patience_s=PATIENCE_S)
    assert done.status == 0, done.words
    return done


@pytest.mark.timeout(200)
@pytest.mark.parametrize(
    "kind", [pytest.param("hybrid", marks=pytest.mark.slow), pytest.param("paper", marks=pytest.mark.compiled)]
)
def test_a_drive_on_a_learned_model_is_flagged_where_it_leaves_its_region(kind: str, tmp_path: Path) -> None:
    done = ended("drive", write_bench(tmp_path), "--model", narrow(tmp_path / kind, kind))
    assert done.data["outside"]["share"] > 0.5 and set(done.data["outside"]["drives"]) == {"tiny"}
    assert "outside the valid region" in done.data["sentence"]
    assert "outside the valid region of the model" in done.words


@pytest.mark.slow
@pytest.mark.timeout(200)
def test_a_tune_on_a_learned_model_has_the_share_beside_its_winner(tmp_path: Path) -> None:
    path = write_bench(tmp_path)
    path.write_text(path.read_text().replace('model = "mkz_nominal"', f'model = "{narrow(tmp_path / "m", "lstm")}"', 1))
    done = ended("tune", path, "--trials", 1, "--no-verify")
    assert done.data["outside"]["share"] > 0.5 and "speed_mps" in done.data["outside"]["by"]
    assert "outside the valid region" in done.data["sentence"]
