"""The line about a model: a learned one says how good it is, the others what they are."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.house import ROOT
from tests.plant.model_files import write_model
from tunefree_hil.config.load import load_model
from tunefree_hil.jobs.learn.report_text import describe_model, position_error


def card(mean_m: Any = 0.62) -> dict[str, Any]:
    """What of a card counts here."""
    level = {"10": {"position_m": {"mean": mean_m}}}
    logs = [{"name": "a", "seconds": 700.0}, {"name": "b", "seconds": 500.0}]
    return {"kind": "hybrid", "logs": logs, "free_run": {"hybrid": {"level": level, "hills": None}}}


def said(folder: Path, text: str) -> str:
    """The words about a learned model with this card."""
    model = write_model(folder, "hybrid")
    path = model / "model.toml"
    path.write_text(path.read_text().replace('kind = "hybrid"', 'kind = "hybrid"\ncard = "card.json"'))
    (model / "card.json").write_text(text)
    return describe_model(load_model(model))


def test_what_a_card_says(tmp_path: Path) -> None:
    assert said(tmp_path / "m", json.dumps(card())) == (
        "model m: hybrid, learned from 20 min of logs; 0.6 m off after 10 s of free run on held-out data"
    )


@pytest.mark.parametrize(
    ("text", "end"),
    [
        (json.dumps({**card(), "free_run": {}}), "hybrid, learned from 20 min of logs"),
        ("{}", "hybrid"),
        ("[]", "its card.json holds no object"),
        ("{", "(Expecting property name enclosed in double quotes: line 1 column 2 (char 1))"),
    ],
)
def test_a_card_that_says_less(text: str, end: str, tmp_path: Path) -> None:
    assert said(tmp_path / "m", text).endswith(end)


def test_a_model_that_nobody_learned() -> None:
    assert describe_model(load_model(ROOT / "bench_configs" / "models" / "mkz_nominal")) == "model mkz_nominal: physics"


@pytest.mark.parametrize("mean_m", [None, "far", float("nan")])
def test_an_error_that_is_no_number(mean_m: Any) -> None:
    assert position_error(card(mean_m)) is None
