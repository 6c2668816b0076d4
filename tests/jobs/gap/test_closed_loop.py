"""Closed loop again: the repaired model tracks as the measured car did, and who drove a foreign log is not known."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from tests.gap.made_answer import VEHICLE, answer, made_kept
from tests.jobs.ended import ended
from tests.jobs.made_runs import made_drive
from tunefree_hil.bench import load
from tunefree_hil.config.load import load_model
from tunefree_hil.gap.repair import found_effects, repaired, write_repaired
from tunefree_hil.jobs.gap.closed_loop import MEASURED, SIGNALS, UNKNOWN, Sum, compared, replayed
from tunefree_hil.jobs.gap.gap import Material
from tunefree_hil.jobs.gap.repair import Mended

DELAY_S = 0.12
pytestmark = pytest.mark.slow
BENCH = """
schema = "tunefree.bench/1"
vehicle = "mkz_bywire"
model = "mkz_nominal"
scenarios = ["{scenario}"]
[[effects]]
name = "steer_dead_time"
params = {{ delay_s = {delay_s} }}
"""


def asked(logs: list[Path], delay_s: float, place: Path) -> tuple[dict[str, Any] | None, str]:
    """With a model that was repaired by so much."""
    model = load_model("mkz_nominal")
    value = {"value": delay_s, "low": delay_s, "high": delay_s, "unit": "s"}
    effects = [{"name": "steer_dead_time", "params": {"delay_s": value}, "evidence": 9.0}]
    kept = made_kept()._replace(answer=answer(effects=effects))
    made = repaired(model, VEHICLE, {}, found_effects(kept, "", ""))
    written = write_repaired(place, model, made.model, {})
    mended = Mended(repaired(model, VEHICLE, {}), made, written)
    found, _ = ended(replayed(logs, Material(VEHICLE, model, [], []), mended))
    return found


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive on the nominal car with a steering that answers later."""
    root = tmp_path_factory.mktemp("runs")
    own = load("bench_configs/mkz_steer.toml")
    name = min(own.spec.scenarios, key=lambda one: own.scenarios[one].speed.t_s[-1])
    (root / "b.toml").write_text(BENCH.format(scenario=name, delay_s=DELAY_S))
    episode = made_drive(root / "b.toml", root, "late", {}) / "episodes" / "0"
    said = json.loads((episode / "episode.json").read_text())  # a bench writes down the seed that it drove with
    (episode / "episode.json").write_text(json.dumps({**said, "seed": own.scenarios[name].noise_seed}))
    return episode / "vehicle.log"


def test_the_true_repair_tracks_as_the_measured_car_did(log: Path, tmp_path: Path) -> None:
    found, why = asked([log], DELAY_S, tmp_path / "right")
    assert why == "" and found is not None and found["drives"] == 1
    assert found["down_frac"] == 1.0 and found["worst_frac"] == -1.0, "the batch drives what the bench did, bit by bit"
    lateral = found["signals"]["lateral_error_m"]
    assert lateral["before"] == lateral["recalibrated"] > 0.02 and lateral["after"] == 0.0


def test_a_wrong_one_does_not(log: Path, tmp_path: Path) -> None:
    found, _ = asked([log], 2.5 * DELAY_S, tmp_path / "wrong")
    assert found is None or found["down_frac"] < 0.0


def test_who_drove_a_foreign_log_is_not_known(log: Path, tmp_path: Path) -> None:
    other = tmp_path / "some.log"
    other.write_bytes(log.read_bytes())
    assert asked([other], DELAY_S, tmp_path / "model") == (None, UNKNOWN)


def test_a_drive_on_the_vehicle_is_the_tunes_own(log: Path, tmp_path: Path) -> None:
    run = log.parent.parent.parent
    place = tmp_path / "tune"
    shutil.copytree(run / "episodes", place / "verify" / "episodes")  # as `verify` leaves it: all else is beside it
    for name in ("run.json", "bench.toml"):
        shutil.copyfile(run / name, place / name)
    found, why = asked([place / "verify" / "episodes" / "0" / "vehicle.log"], DELAY_S, tmp_path / "model")
    assert why == "" and found is not None and found["down_frac"] == 1.0


def summed(**rms: tuple[float, float, float]) -> dict[str, dict[str, list[Sum]]]:
    """RMS (measured, before, after) by signal, over ten rows."""
    keys = (MEASURED, "before", "after")
    return {
        name: {key: [Sum(10.0 * one * one, 10)] for key, one in zip(keys, some, strict=True)}
        for name, some in rms.items()
    }


def test_an_error_that_was_next_to_none_before_decides_nothing() -> None:
    large = {"lateral_error_m": (0.2, 0.1, 0.01)}
    assert compared(summed(**large), 1)["down_frac"] == pytest.approx(0.9)
    both = compared(summed(**large, heading_error_rad=(0.02, 1e-6, 1e-5)), 1)
    assert both["down_frac"] == pytest.approx(0.9, abs=1e-3) and both["worst"] == "lateral_error_m"
    assert "down by 90 %, lateral_error_m least, down by 90 %" in both["words"]


def test_squares_are_pooled_over_drives_by_their_rows() -> None:
    short, long = summed(speed_error_mps=(1.0, 1.0, 1.0)), summed(speed_error_mps=(1.0, 1.0, 0.0))
    pooled = {
        name: {key: [*some[key], Sum(9 * long[name][key][0].squares, 90)] for key in some}
        for name, some in short.items()
    }
    assert compared(pooled, 2)["down_frac"] == pytest.approx(1.0 - 0.1**0.5)


def test_a_difference_that_was_none_and_is_one_now_counts_as_worse() -> None:
    found = compared(summed(lateral_error_m=(0.2, 0.1, 0.05), speed_mps=(10.0, 0.0, 1.0)), 1)
    assert found["worst"] == "speed_mps" and found["worst_frac"] > 10.0 and "speed_mps is up" in found["words"]
    nothing = compared(summed(**{name: (1.0, 0.0, 0.0) for name in SIGNALS}), 1)
    assert nothing["down_frac"] is None and nothing["words"] == "no difference"
