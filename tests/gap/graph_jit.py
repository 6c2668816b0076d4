"""Run by test_graph.py in a process whose kernels are compiled: prints what it found as JSON."""

from __future__ import annotations

import json
import math

import numpy as np

from tests.learn.made_drives import CHANNELS, made_drive
from tunefree_hil.base.contracts import prior_of
from tunefree_hil.config.load import load_model, load_vehicle
from tunefree_hil.gap.estimation.candidates import vehicle_sizes
from tunefree_hil.gap.measured.chain import build_measured_drive
from tunefree_hil.gap.model.graph import EffectGraph


def main() -> None:
    """Every effect on, one after the other."""
    vehicle, model = load_vehicle("mkz_bywire"), load_model("mkz_nominal")
    opened = build_measured_drive(made_drive(20.0, channels=CHANNELS), vehicle)
    graph = EffectGraph(model, vehicle, opened.dt_s)
    neutral = graph.simulate(opened.inputs, {})
    loops = (graph._run_actuators, graph._run_vehicle)  # all that is compiled
    compiled = [sum(len(one.signatures) for one in loops)]
    changed, same, sizes = {}, {}, vehicle_sizes(model, vehicle, graph)
    for name, effect in graph.supported.items():
        off = {f"{name}.{key}": value for key, value in effect.neutral.items()}
        priors = {key: prior_of(effect, key, sizes) for key in effect.neutral}
        limits = {key: math.isinf(value) for key, value in effect.neutral.items()}  # as low as a drive may reach
        on = {f"{name}.{key}": prior.low if limits[key] else prior.typical for key, prior in priors.items()}
        same[name] = bool(np.array_equal(graph.simulate(opened.inputs, off), neutral))
        changed[name] = bool(np.abs(graph.simulate(opened.inputs, on) - neutral).max() > 1e-6)
    both = {"steer_lag.tau_s": 0.1, "brake_gain.gain_frac": 0.8, "payload.mass_kg": 100.0, "clock.ins_s": 0.01}
    graph.simulate(opened.inputs, both)
    compiled.append(sum(len(one.signatures) for one in loops))
    print(json.dumps({"compiled": compiled, "same": same, "changed": changed, "cannot": graph.unsupported}))


if __name__ == "__main__":
    main()
