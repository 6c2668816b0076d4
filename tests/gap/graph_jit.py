"""Run by test_graph.py in a process whose kernels are compiled: prints what it found as JSON."""

from __future__ import annotations

import json
import math

import numpy as np

from tests.learn.made_drives import CHANNELS, made_drive
from tunefree_hil.base.contracts import prior_of
from tunefree_hil.config.load import load_model, load_vehicle
from tunefree_hil.gap.estimation.candidates import sizes_of
from tunefree_hil.gap.measured.chain import open_chain
from tunefree_hil.gap.model.graph import Graph


def main() -> None:
    """Every effect on, one after the other."""
    vehicle, model = load_vehicle("mkz_bywire"), load_model("mkz_nominal")
    opened = open_chain(made_drive(20.0, channels=CHANNELS), vehicle)
    graph = Graph(model, vehicle, opened.dt_s)
    neutral = graph.run(opened.inputs, {})
    loops = (graph._heads, graph._ride)  # all that is compiled
    compiled = [sum(len(one.signatures) for one in loops)]
    changed, same, sizes = {}, {}, sizes_of(model, vehicle, graph)
    for name, effect in graph.can.items():
        off = {f"{name}.{key}": value for key, value in effect.neutral.items()}
        priors = {key: prior_of(effect, key, sizes) for key in effect.neutral}
        limits = {key: math.isinf(value) for key, value in effect.neutral.items()}  # as low as a drive may reach
        on = {f"{name}.{key}": prior.low if limits[key] else prior.typical for key, prior in priors.items()}
        same[name] = bool(np.array_equal(graph.run(opened.inputs, off), neutral))
        changed[name] = bool(np.abs(graph.run(opened.inputs, on) - neutral).max() > 1e-6)
    both = {"steer_lag.tau_s": 0.1, "brake_gain.gain_frac": 0.8, "payload.mass_kg": 100.0, "clock.ins_s": 0.01}
    graph.run(opened.inputs, both)
    compiled.append(sum(len(one.signatures) for one in loops))
    print(json.dumps({"compiled": compiled, "same": same, "changed": changed, "cannot": graph.cannot}))


if __name__ == "__main__":
    main()
