"""Verify over a real bus: the winner against a manual vector, their margins from the batch's drives, un-jitted here."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import pytest

from tests.bench.tiny import write_bench
from tests.jobs.command import new_session, no_orphans
from tests.jobs.made_runs import made_tune
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bench import load, parameters_of
from tunefree_hil.bench.parallel import Fleet
from tunefree_hil.config.dump import to_toml
from tunefree_hil.grade import score
from tunefree_hil.grade.margins import NOMINAL, SWEEPS
from tunefree_hil.jobs.options.records import VerifyOptions
from tunefree_hil.jobs.run_folder import RunFolder, write_text
from tunefree_hil.jobs.tune import margins, verify
from tunefree_hil.jobs.tune.candidates import compute_baseline_vectors, read_winner

FEW = {
    "friction": (NOMINAL._replace(friction=0.8), NOMINAL._replace(friction=0.6)),
    "lag": (NOMINAL._replace(lag=1.4),),
}
SHORT = {what: cars[:2] for what, cars in SWEEPS.items()}


class HereBatch(Fleet):
    """A Batch whose drives are made in this process."""

    def __init__(self, bench: Any, model: str, *, extra_effects: tuple[str, ...]) -> None:
        super().__init__(bench, model, extra_effects, 1)

    def __enter__(self) -> HereBatch:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A finished tune whose winner is known, of one scenario of a second."""
    bench_file = write_bench(tmp_path, duration_s=1.0)
    path = made_tune(bench_file, tmp_path / "runs", 1)
    values = parameters_of(load(bench_file), {"mrac.p": 0.002})
    write_text(path / "best.toml", to_toml({"schema": "tunefree.best/1", "parameters": values}))
    return path


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few changed cars, and one manual vector."""
    monkeypatch.setattr(margins, "POINTS", FEW)
    monkeypatch.setattr(margins, "SWEEPS", SHORT)
    monkeypatch.setattr(margins, "Batch", HereBatch)
    monkeypatch.setattr(
        verify, "compute_baseline_vectors", lambda bench: {"mrac_on": compute_baseline_vectors(bench)["mrac_on"]}
    )


def ended(run: Path, session: str) -> list[Event]:
    return list(verify.verify(VerifyOptions(run, bus="tfhub", session=session)))


@pytest.mark.slow
def test_verify_prints_margins_and_keeps_them(run: Path, few: None) -> None:
    session = new_session()
    with no_orphans(session):
        *events, result = ended(run, session)
    found = json.loads((run / "verify.json").read_text())
    assert found["outside"]["model"] == "mkz_nominal" and found["outside"]["share"] == 0.0
    kept = found["margins"]
    assert kept["same_as_bus"] == {"equal": 2, "of": 2}  # the batch's drives are those of the bus, bit for bit
    assert kept["against"] == "mrac_on" and set(kept["vectors"]) == {"tuned", "mrac_on"}
    assert kept["vectors"]["tuned"]["delay"] == {"value": 0.01, "at_least": True, "scenario": "", "what": ""}
    assert [one["what"] for one in kept["vectors"]["tuned"]["points"]] == [
        "friction -20 %",
        "friction -40 %",
        "lag +40 %",
    ]
    assert all(one["steering"]["rate_rms_radps"] > 0.0 for one in kept["vectors"].values())
    assert result.kind == "result" and result.message == found["sentence"]
    assert "delay margin >= 10 ms against >= 10 ms of mrac_on" in found["sentence"]
    table = [
        event.message for event in events if event.kind == "note" and event.message.startswith(("tuned", "mrac_on"))
    ]
    assert len(table) == 4 and ">= 10 ms" in table[2] + table[3]
    assert [Path(one).name for one in found["figures"]] == ["before_after.png", "margins.png", "verify_tiny.png"]
    assert any(event.kind == "progress" and event.data["label"] == "margins" for event in events)
    assert found["verdict"] in ("ACCEPTED", "NO GAIN") and found["sentence"].startswith(f"{found['verdict']}: ")
    assert result.data["exit"] == (0 if found["verdict"] == "ACCEPTED" else 1)
    best = tomllib.loads((run / "best.toml").read_text())
    assert best["verdict"] == found["verdict"] and best["verification"]["roads"] == ["tiny"]


@pytest.mark.slow
def test_a_winner_that_violates_a_requirement_on_the_vehicle_is_rejected(run: Path, few: None) -> None:
    """The run's bench file is as the search had it; drives of a second show steering and re-plans only."""
    bench_file = run / "bench.toml"
    bench_file.write_text(bench_file.read_text() + "\n[require]\nreplans = 0\n")
    session = new_session()

    def replanned(*arguments: Any) -> Any:
        values = measure(*arguments)
        return values | {"replans": 3.0}

    measure = score.measure_requirements
    with pytest.MonkeyPatch.context() as patch, no_orphans(session):
        patch.setattr(score, "measure_requirements", replanned)
        *_, result = ended(run, session)
    assert result.data["exit"] == 1 and result.data["verdict"] == "REJECTED"
    assert result.message.startswith("REJECTED: replans 3 > 0 on tiny; no manual set meets the requirements")
    text = (run / "best.toml").read_text()
    assert text.startswith("# REJECTED: replans 3 > 0 on tiny: do not paste")
    assert read_winner(load(bench_file), RunFolder(run, {}))["mrac.p"] == pytest.approx(0.002)


@pytest.mark.slow
def test_a_batch_that_cannot_be_had_costs_the_margins_only(
    run: Path, few: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none(*_: Any, **__: Any) -> Any:
        raise InputError("it does not compile", code="not_in_batch")

    monkeypatch.setattr(margins, "Batch", none)
    session = new_session()
    with no_orphans(session):
        *events, result = ended(run, session)
    found = json.loads((run / "verify.json").read_text())
    assert found["margins"]["reason"] == "not_in_batch: it does not compile"
    assert found["margins"]["vectors"]["tuned"]["delay"] is None
    assert found["margins"]["vectors"]["tuned"]["steering"]["rate_rms_radps"] > 0.0
    assert "delay" not in result.message and result.data["scores"].keys() == {"tuned", "mrac_on"}
    assert any(event.kind == "warning" and "no margins of mkz_nominal" in event.message for event in events)


def test_a_run_that_is_no_tune_is_refused(tmp_path: Path) -> None:
    from tests.jobs.made_runs import made_drive

    bench_file = write_bench(tmp_path, duration_s=1.0)
    path = made_drive(bench_file, tmp_path / "runs", "drive", {})
    with pytest.raises(InputError, match="is a run of 'drive'"):
        list(verify.verify(VerifyOptions(path, bus="tfhub")))
