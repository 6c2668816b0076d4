"""The measure of the MPC: both controllers are searched alike, and what was driven is not driven again."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from tests.bench.tiny import write_scenario
from tests.house import ROOT
from tools.measures import _mpc_study, mpc
from tools.measures._mpc_study import LQR, MPC, space_of, write_benches
from tools.measures._rig import Rig
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import load
from tunefree_hil.config.dump import to_toml

BENCH = ROOT / "bench_configs" / "mkz_mpc.toml"


def short_bench(folder: Path) -> Path:
    """The bench of the measure with two short roads, on plants that need no compiler."""
    data = tomllib.loads(BENCH.read_text())
    data |= {"scenarios": ["bend"], "verify_scenarios": ["other_bend"]}
    data |= {"model": "mkz_nominal", "verify_model": "mkz_nominal"}
    write_scenario(folder, "bend", 6.0)
    write_scenario(folder, "other_bend", 6.0, -0.03)
    path = folder / "short.toml"
    path.write_text(to_toml(data))
    return path


def test_the_other_bench_differs_in_the_controller_alone(tmp_path: Path) -> None:
    files = write_benches(BENCH, tmp_path)
    ours, other = load(files[MPC]), load(files[LQR])
    assert (other.spec.controller.lateral, other.spec.controller.longitudinal) == ("lqr_preview", "pid_preview")
    for name in ("vehicle", "model", "verify_model", "seed", "weights", "scenarios", "verify_scenarios"):
        assert getattr(ours.spec, name) == getattr(other.spec, name)
    assert (ours.spec.tune.sampler, ours.spec.controller.inner) == (
        other.spec.tune.sampler,
        other.spec.controller.inner,
    )
    assert len(space_of(ours).axes) == 8 and len(space_of(other).axes) == 9
    assert all(axis.name.startswith("mpc.") for axis in space_of(ours).axes)


def test_a_wrong_scenario_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no scenario in 'nowhere'") as caught:
        mpc.measure(trials=1, seeds=1, scenarios="nowhere", folder=str(tmp_path))
    assert caught.value.key == "--scenarios"


@pytest.mark.slow
@pytest.mark.timeout(300)  # it starts a dozen benches
def test_a_small_measure_over_the_bus_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = short_bench(tmp_path)
    options = {"trials": 2, "seeds": 1, "workers": 1, "bench": str(path), "folder": str(tmp_path / "rows")}
    first = mpc.measure(seconds=1, **options)
    (row,) = first["detail"]["seeds"]
    scores = [row[name]["verify_model"] for name in (MPC, LQR)]
    assert first["n"] == 1 and first["value"] == pytest.approx(scores[0] / scores[1], rel=1e-3)
    assert row[MPC]["search_model"] <= first["detail"]["manual"][MPC]["search_model"], "its first trial"
    times = first["detail"]["times"]
    for name in ("lockstep", "realtime"):
        plans = times[MPC][name]["plans"]
        assert plans["lateral"]["ticks"] > 90 and plans["lateral"]["failed"] == 0
        assert times[LQR][name]["plans"] == {}
        assert 0.0 < times[MPC][name]["cycle_ms"]["median"] <= times[MPC][name]["cycle_ms"]["p99"]

    def refuse(self: Rig) -> None:
        raise AssertionError("a bench was started")

    monkeypatch.setattr(_mpc_study.Rig, "_start", refuse)
    again = mpc.measure(seconds=0, **options)
    assert again["detail"]["seeds"] == first["detail"]["seeds"]
