"""gap with its real search: a hidden dead time is named, repaired and proved; going on comes to the same bytes."""

from __future__ import annotations

import json
import shutil
from collections.abc import Generator, Sequence
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from tests.gap.made_answer import LATE_S, VEHICLE, late_drive, made_model
from tunefree_hil.base.events import Event
from tunefree_hil.jobs.gap import gap as module
from tunefree_hil.jobs.gap.folder import ANSWER, QUESTION, SEARCH
from tunefree_hil.jobs.gap.gap import run_gap
from tunefree_hil.jobs.gap.options import GapOptions
from tunefree_hil.learn.drives.drive import Drive

pytestmark = [pytest.mark.slow, pytest.mark.compiled, pytest.mark.timeout(900)]


def read(*_: Any, **__: Any) -> Generator[Event, None, list[Drive]]:
    yield Event("note", "reading")
    return [late_drive()]


def result(
    out: Path, logs: Sequence[Path] = (Path("late.log"),), workers: int = 2
) -> tuple[list[Event], dict[str, Any]]:
    events = list(run_gap(GapOptions(logs, VEHICLE.folder, "mkz_nominal", out, workers=workers)))
    return events, events[-1].data


def test_it_is_named_repaired_and_proved_and_gone_on_with(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "read_logs", read)
    monkeypatch.setattr(module, "load_checked_model", lambda *_: replace(made_model(), hash="a model"))
    events, data = result(tmp_path / "out")
    assert any("eta_s" in event.data for event in events if event.kind == "progress")
    assert data["verdict"] == "one" and data["forced"] == "steer_dead_time", data["sentence"]
    delay = data["effects"][0]["params"]["delay_s"]
    assert delay["value"] == pytest.approx(LATE_S, abs=0.005) and delay["low"] < delay["value"] < delay["high"]
    assert data["explained_frac"]["value"] > 0.9 and data["worse"] == [] and data["model"]
    again = tmp_path / "again"
    again.mkdir()
    for name in (QUESTION, SEARCH):  # as a kill after the search leaves it
        shutil.copyfile(tmp_path / "out" / name, again / name)
    _, same = result(again)
    _, alone = result(tmp_path / "alone", workers=1)
    assert same["verdict"] == alone["verdict"] == "one"
    first, *others = (said(tmp_path / folder) for folder in ("out", "again", "alone"))
    assert others == [first, first], "gone on with, and searched by one process"


def said(folder: Path) -> str:
    """An answer without its place and what it took."""
    data = {**json.loads((folder / ANSWER).read_text()), "elapsed_s": 0}
    return json.dumps(data).replace(str(folder), "")
