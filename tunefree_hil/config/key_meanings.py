"""The meaning of each key of the TOML files (vehicle.toml: vehicle_key_meanings.py): `doctor --schema NAME`."""

from __future__ import annotations

from tunefree_hil.config.import_schema import ClockSpec, ColumnSpec, EnabledSpec, ImportSpec
from tunefree_hil.config.learned.steering_map_schema import STEERING_MAP_WORDS
from tunefree_hil.config.schema import (
    ActuatorSpec,
    BenchSpec,
    ControllerSpec,
    EffectSpec,
    FaultSpec,
    Interval,
    ModelSpec,
    ParameterSpec,
    PlantSpec,
    ProfileSpec,
    RoadsSpec,
    ScenarioSpec,
    Spec,
    StartSpec,
    TimingSpec,
    TuneSpec,
    ValidSpec,
    WeightsSpec,
)
from tunefree_hil.config.tuning.ensemble_schema import ENSEMBLE_WORDS, EnsembleSpec
from tunefree_hil.config.tuning.require_schema import REQUIRE_WORDS, RequireSpec
from tunefree_hil.config.vehicle_key_meanings import ASSUMED, VEHICLE_WORDS

SCHEMA = "kind and version of this file"
SPAN = "[low, high] that the data covered; left out: not checked"

_MODEL: dict[type[Spec], dict[str, str]] = {
    ModelSpec: {
        "schema": SCHEMA,
        "vehicle": "name of the vehicle that it is a model of",
        "vehicle_hash": "'sha256:...' of the vehicle's folder as it was then; another one is refused; '' for any",
        "actuators": "tables [actuators.CHANNEL]: throttle, brake, steer, or those that are commanded instead",
        "plant": "how the body moves",
        "timing": "ticks that frames take",
        "noise": "record field, such as 'report.speed_mps' -> standard deviation of its noise, in its unit",
        "bias": "record field -> constant that is added to it, in its unit",
        "valid": "the region that the data covered",
        "effects": "effects that were found in logs and added",
    },
    ActuatorSpec: {
        "dead_time_s": "s from a command to the first answer",
        "order": "of the lag: 1 (lag_s) or 2 (natural_hz, damping)",
        "lag_s": "time constant of a lag of order 1, s",
        "natural_hz": "natural frequency of a lag of order 2, Hz",
        "damping": "damping of a lag of order 2; 1: it just does not overshoot",
        "rate_limit": "fastest change of the output, duty or rad per s; inf: none",
        "dead_band": "what is taken off the command either side of rest, duty or rad",
        "gain": "output per command, both from rest",
        "offset": "what is added to the output, duty or rad",
    },
    Interval: {
        "value": "the value that is used",
        "low": "lower end of its interval",
        "high": "upper end of its interval",
    },
    PlantSpec: {
        "kind": "physics, reference, hybrid, lstm, mlp, rule_based, paper, or 'path/to/file.py:EXPORT' of your own",
        "file": "file in this folder in which a learned plant lives; '' for the kind's usual one",
        "card": "file in this folder with its origin and quality; '' for none",
        "params": "physical constants by name; those left out are the kind's own",
    },
    TimingSpec: {
        "report_ticks": "ticks that reports are late",
        "command_ticks": "ticks that commands are late",
        "phase_seed": "draws the tick of its period on which each message goes out",
    },
    ValidSpec: {
        "speed_mps": f"{SPAN}, m/s",
        "accel_mps2": f"{SPAN}, m/s2",
        "lateral_accel_mps2": f"{SPAN}, m/s2 to the side",
        "pedals": f"{SPAN}, duty at the actuators' outputs, the brake's negative",
        "steer_rad": f"{SPAN}, rad at the steering wheel",
    },
    EffectSpec: {
        "name": "one of docs/reference/effects.md, or 'path/to/file.py:EFFECT' of your own",
        "params": "its numbers by name, with the units in the names",
        "interval": "parameter -> [low, high] in which it was found",
        "provenance": "where it comes from: log, seed, version",
    },
}

_ROADS: dict[type[Spec], dict[str, str]] = {
    ScenarioSpec: {
        "schema": SCHEMA,
        "name": "what results call it",
        "description": "what is driven, in a sentence",
        "noise_seed": "draws the sensors' noise, 0 to 65535",
        "start": "where the rear axle stands at the beginning, from the path's own beginning",
        "speed": "planned speed of the rear axle over time, m/s; its last t_s is the duration",
        "curvature": "planned curvature of the path over time, 1/m, positive to the left",
        "grade": "slope of the road over time, rad, positive uphill; left out: level",
        "friction": "friction over time, as a share of the model's own; left out: 1",
        "bank": "bank of the road over time, rad, positive with its left side up; left out: level",
        "side_wind": "force of a side wind over the vehicle's mass over time, m/s2, to the left; left out: none",
    },
    StartSpec: {
        "along_m": "m ahead along the path's first direction",
        "lateral_m": "m to the left of the path",
        "heading_rad": "heading from the path's, rad to the left",
        "speed_mps": "speed, m/s",
    },
    ProfileSpec: {
        "t_s": "times of the breakpoints, s, ascending from 0.0",
        "value": "the value at each of them; linear between two",
    },
    WeightsSpec: {
        "schema": SCHEMA,
        "name": "what results call it",
        "description": "what is weighed, in a sentence",
        "against": "trajectory that errors count against: current (a re-plan forgives) or original",
        "as_published": "true keeps the source's slip in heading_err_rate_std_harsh",
        "metrics": "metric of docs/reference/grading.md -> weight from 0 on",
        "largest_value": "a metric counts up to this value, so that none drowns the rest; 0: whatever it is",
        "replan_penalty": "what a re-plan adds to a score",
        "failure_score": "score of a drive that fails, and the highest there is",
        "lane_half_width_m": "sideways error at which the lane is left, m",
        "divergence_heading_rad": "heading error at which the drive has diverged, rad",
    },
}

_BENCH: dict[type[Spec], dict[str, str]] = {
    BenchSpec: {
        "schema": SCHEMA,
        "vehicle": "vehicle folder, by name or path",
        "model": "model folder that is driven and searched on, by name or path",
        "verify_model": "model folder that stands for the vehicle in `verify`; '' for none",
        "scenarios": "scenarios that are driven, by name or path",
        "verify_scenarios": "scenarios that only `verify` drives",
        "roads": "sets of roads that are made for the vehicle and driven too",
        "weights": "weights file by which drives are scored, by name or path",
        "seed": "of the search",
        "controller": "which controller, and its fixed values",
        "tune": "what is searched and how",
        "ensemble": "the cars that every candidate drives; left out: the model alone",
        "require": "limits that gains must keep on every road; left out: the vehicle's defaults",
        "effects": "tables [[effects]]: what the model is made worse by",
        "faults": "tables [[faults]]: what goes wrong on the bus, and when",
    },
    RequireSpec: REQUIRE_WORDS,
    EnsembleSpec: ENSEMBLE_WORDS,
    RoadsSpec: {
        "search": "set driven beside `scenarios`: families:N, robust:N or public229; '' for none",
        "verify": "set driven beside `verify_scenarios`, with other chance; '' for none",
        "seed": "draws the roads, 0 to 9999",
    },
    ControllerSpec: {
        "lateral": "'lqr', 'lqr_preview', 'mpc', or 'path/to/file.py:CONTROLLER' of your own",
        "longitudinal": "'pid', 'pid_preview', 'mpc', or 'path/to/file.py:CONTROLLER' of your own",
        "inner": "'mrac', 'mrac_robust', or 'path/to/file.py:CONTROLLER' of your own",
        "riccati": "the gains' equation: solved until it converged, or stopped after 150 rounds as Apollo does",
        "look_ahead_m": "m ahead of the vehicle at which the path is looked at",
        "mrac_order": "order of MRAC's reference model, 1 to 4; from 3 on it includes the steering's dead time",
        "mrac_form": "MRAC as Apollo ships it, or the paper's eq. 6 alone, without bounds, clamp and dead zone",
        "mrac_dead_zone": "percent of the steering limit within which MRAC does not adapt",
        "calibration": "another calibration.npz than the model's; '' for the model's",
        "steering_map": "path of a steering_map.toml, or 'data_sheet'; '' for that of the model, else its axles",
        "parameters": "parameter -> value, of those that are not searched",
        "command": "program and arguments of a controller of your own, instead of ours",
    },
    TuneSpec: {
        "set": "a named set of parameters: mrac, lateral or complete; '' where `parameters` lists them",
        "parameters": "tables of the parameters that are searched, instead of `set`",
        "trials": "number of parameter sets to try",
        "sampler": "what suggests the next set (docs/reference/samplers.md); auto: as suits trials and backend",
        "kappa_w": "weight of the uncertainty for the sampler gp_ucb, above 0 (eq. 8): more explores more",
        "backend": "what drives the trials: bus, or batch (compiled; the best ones are confirmed over the bus)",
        "in_flight": "trials that are asked for together; 0: as suits bench and machine",
        "box": "paper: the published ranges; default: the wider ones; '': default where there is a table [require]",
        "starts": "first: the search begins with one manual set; manual: with all of them, clipped",
        "objectives": "[]: the score; ['tracking', 'comfort']: both parts of it, and the best trade of them wins",
        "slower": "the winner also drives calmly with actuators so many times slower, 1 to 10; 1: best grade alone",
    },
    ParameterSpec: {
        "name": "name of the parameter",
        "low": "lower end of its box; without low, high and choices the parameter's own box counts",
        "high": "upper end of its box",
        "scale": "log or linear, in which it is drawn",
        "step": "distance between values; left out: any value",
        "choices": "the allowed values, instead of a box",
    },
    FaultSpec: {
        "channel": "throttle, brake, steer or gear of driver_override, ecu or controller of peer_stop; else ''",
        "message": "message that is disturbed where it is sent; '' for driver_override and peer_stop",
        "kind": "one of docs/reference/faults.md",
        "from_tick": "first tick of it",
        "to_tick": "first tick after it",
        "value": "what it means for the kind: docs/reference/faults.md",
        "seed": "of its random numbers, 0 to 65535",
    },
}

_IMPORT: dict[type[Spec], dict[str, str]] = {
    ImportSpec: {
        "schema": SCHEMA,
        "name": "what the vehicle and the log are called",
        "source": "where the data are from, and their licence",
        "clock": "the time column",
        "columns": "tables [[columns]]: which column is which record field",
        "enabled": "the column that shows whether the vehicle obeyed its commands; left out: not known",
        "delimiter": "between two cells",
        "decimal": "the decimal point of the numbers",
        "accept": "plausibility check that may fail -> why this drive is right all the same",
        "limits": "limits of the vehicle that is written; left out: what was driven",
        "nominal": "data-sheet constants of the vehicle that is written",
    },
    ClockSpec: {
        "column": "header of the column",
        "unit": "s, ms, us or ns",
        "gap_s": "shortest silence that counts as a gap, s; 0: three times the usual step",
    },
    ColumnSpec: {
        "column": "header of the column",
        "field": "record field, such as 'report.speed_mps'",
        "unit": "unit of (cell * scale + offset)",
        "scale": "what a cell is multiplied by: a sign, a gauge's gain",
        "offset": "what is added then, in `unit`",
        "period_ms": "ms between two frames that are made of it at least; 0: one for every row",
        "new_when": "column that changes where this one was measured anew; '': it is new in every row",
        "assumed": ASSUMED,
    },
    EnabledSpec: {
        "column": "header of the column",
        "active": "value of a cell that means that it obeyed",
    },
}

WORDS: dict[str, dict[str, str]] = {
    kind.__name__: words
    for kind, words in (
        *VEHICLE_WORDS.items(),
        *_MODEL.items(),
        *_ROADS.items(),
        *_BENCH.items(),
        *_IMPORT.items(),
        *STEERING_MAP_WORDS.items(),
    )
}
