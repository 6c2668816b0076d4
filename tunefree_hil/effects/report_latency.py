"""All chassis reports delayed, including echoes of commands and status bits."""

from __future__ import annotations

from tunefree_hil.base.contracts import Block, Effect, Link, Need, Port, Prior
from tunefree_hil.effects._latency import late_report


def make(params: dict[str, float], rest: float) -> Block:
    """Block on Report: the report of delay_s [s] ago; the vehicle delays the bits of these frames as well."""
    return late_report(params["delay_s"])


EFFECT = Effect(
    Port.REPORT,
    {"delay_s": 0.0},
    {"delay_s": "s"},
    make,
    "every chassis report is late by the same time against commands and INS",
    priors={"delay_s": Prior(0.01, 0.5, 0.06)},
    impostors=("steer_dead_time", "throttle_dead_time", "brake_dead_time", "yaw_rate_filter", "ins_latency"),
    manoeuvre="steps of steering, throttle and brake: echoes, outputs and speeds are all late together, the INS is not",
    needs=(Need("steer_moves", 4.0), Need("moving_s", 20.0)),
    links=(Link.CLOCK,),
)
