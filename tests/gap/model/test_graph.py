"""One compiled car for all effects: neutral is no effect, on is one, and nothing is compiled for a candidate."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from tests.learn.made_drives import CHANNELS, made_drive
from tunefree_hil.base import parts
from tunefree_hil.base.contracts import Effect, Link, Port, Prior
from tunefree_hil.config.load import load_model, load_vehicle
from tunefree_hil.effects import catalogue
from tunefree_hil.effects._reports import on_steer
from tunefree_hil.effects._signals import gain, shape, soft
from tunefree_hil.gap.measured.chain import build_measured_drive
from tunefree_hil.gap.model import graph as graphs
from tunefree_hil.gap.model.effect_chain import NOT_AFFINE
from tunefree_hil.gap.model.graph import LINKAGE_BEND_KEY, LINKAGE_BEND_PARAM, EffectGraph, scale_plant_params

ROOT = Path(__file__).resolve().parents[3]


@cache
def found() -> dict[str, Any]:
    done = subprocess.run(
        [sys.executable, "-m", "tests.gap.graph_jit"],
        cwd=ROOT,
        env={**os.environ, "TUNEFREE_JIT": "1"},
        capture_output=True,
        text=True,
        check=True,
        timeout=500,
    )
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.slow
@pytest.mark.compiled
@pytest.mark.timeout(600)
def test_the_whole_catalogue_is_in_the_graph_and_neutral_changes_no_bit() -> None:
    assert set(found()["same"]) == set(parts.names("tunefree_hil.effects")) and not found()["cannot"]
    assert [name for name, same in found()["same"].items() if not same] == []


@pytest.mark.slow
@pytest.mark.compiled
@pytest.mark.timeout(600)
def test_every_effect_changes_something_that_is_compared() -> None:
    assert [name for name, changed in found()["changed"].items() if not changed] == []


@pytest.mark.slow
@pytest.mark.compiled
@pytest.mark.timeout(600)
def test_nothing_is_compiled_for_a_candidate_or_for_two_together() -> None:
    assert found()["compiled"] == [2, 2]


def test_the_linkage_bends_on_any_plant_as_the_single_tracks_own_constant_does() -> None:
    vehicle, model = load_vehicle("mkz_bywire"), load_model("mkz_nominal")
    x = build_measured_drive(made_drive(6.0, channels=CHANNELS), vehicle).inputs
    bent = replace(model, plant=replace(model.plant, params={**model.plant.params, LINKAGE_BEND_PARAM: 0.2}))
    ours, theirs = (
        EffectGraph(model, vehicle, x.dt_s).simulate(x, {LINKAGE_BEND_KEY: 0.2}),
        EffectGraph(bent, vehicle, x.dt_s).simulate(x, {}),
    )
    assert ours == pytest.approx(theirs, abs=1e-9)
    assert np.abs(ours - EffectGraph(model, vehicle, x.dt_s).simulate(x, {})).max() > 1e-5


def test_constants_are_moved_by_the_log_of_a_factor_or_an_amount_of_pedal() -> None:
    moved = scale_plant_params(
        {"mass_kg": 100.0}, {"throttle_zero_frac": 0.2}, {"plant.mass_kg": 0.1, "plant.throttle_zero_frac": 0.01}
    )
    assert moved["mass_kg"] == pytest.approx(110.517, abs=1e-3) and moved["throttle_zero_frac"] == pytest.approx(0.21)


def made_effect(make: Any, parameter: str, neutral: float, typical: float) -> Effect:
    priors = {parameter: Prior(0.5 * typical, 2.0 * typical, typical)}
    units, links = {parameter: "1"}, (Link.COMMAND_TO_REPORT,)
    return Effect(Port.REPORT, {parameter: neutral}, units, make, "made up", priors=priors, links=links)


def test_an_effect_file_that_scales_a_reported_output_is_undone_as_one_that_shifts_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A report that says a tenth too much of an angle, of a car that truly turned as `x` says."""
    scales = made_effect(lambda p, rest: on_steer(gain("scale_frac", p["scale_frac"])), "scale_frac", 1.0, 1.1)
    monkeypatch.setattr(graphs, "load_catalogue", lambda: {**catalogue(), "steer_report_scale": scales})
    vehicle, model = load_vehicle("mkz_bywire"), load_model("mkz_nominal")
    x = build_measured_drive(made_drive(4.0, channels=CHANNELS), vehicle).inputs
    graph = EffectGraph(model, vehicle, x.dt_s)
    true = graph.simulate(x, {})
    for values, outputs in (
        ({"steer_report_scale.scale_frac": 1.1}, x.outputs * [1.0, 1.0, 1.1]),
        (  # in series by name: the offset first, then the scale
            {"steer_report_offset.offset_rad": 0.02, "steer_report_scale.scale_frac": 1.1},
            (x.outputs + [0.0, 0.0, 0.02]) * [1.0, 1.0, 1.1],
        ),
    ):
        shown = graph.simulate(x._replace(outputs=outputs), values)
        assert shown[:, 3:] == pytest.approx(true[:, 3:], rel=1e-9, abs=1e-9, nan_ok=True)
        assert np.abs(shown[:, 2] - true[:, 2]).max() > 1e-3, "the report itself says it"


@pytest.mark.parametrize(
    "make", [lambda half: shape(0.0, half_width=half), lambda tau_s: soft(tau_s, 0.0)], ids=["dead band", "lag"]
)
def test_an_effect_file_whose_report_hides_the_output_is_not_suspected(
    make: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    dead = made_effect(lambda p, rest: on_steer(make(p["half_rad"])), "half_rad", 0.0, 1.5)
    monkeypatch.setattr(graphs, "load_catalogue", lambda: {**catalogue(), "steer_report_dead": dead})
    found = EffectGraph(load_model("mkz_nominal"), load_vehicle("mkz_bywire"), 0.01)
    assert found.unsupported["steer_report_dead"] == NOT_AFFINE and "steer_report_dead" not in found.supported
