"""Delayed INS frames."""

from __future__ import annotations

from tunefree_hil.base.contracts import Block, Effect, Link, Need, Port, Prior
from tunefree_hil.effects._latency import late_ins


def make(params: dict[str, float], rest: float) -> Block:
    """Block on Ins: the record of delay_s [s] ago, in addition to the INS's own latency."""
    return late_ins(params["delay_s"])


EFFECT = Effect(
    Port.INS,
    {"delay_s": 0.0},
    {"delay_s": "s"},
    make,
    "every INS signal is late by the same time against chassis reports",
    priors={"delay_s": Prior(0.01, 0.6, 0.08)},
    impostors=("report_latency", "yaw_rate_filter", "powertrain_lag"),
    manoeuvre="steps of the steering and braking: the INS is later than wheels and gyro by the same time",
    needs=(Need("steer_moves", 4.0), Need("moving_s", 20.0)),
    links=(Link.CLOCK,),
)
