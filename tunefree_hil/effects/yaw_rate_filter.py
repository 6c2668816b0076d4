"""A low-pass filter on the reported yaw rate."""

from __future__ import annotations

from tunefree_hil.base.contracts import Block, Effect, Link, Need, Port, Prior
from tunefree_hil.effects._reports import on_yaw_rate
from tunefree_hil.effects._signals import soft


def make(params: dict[str, float], rest: float) -> Block:
    """Block on Report: a first-order lag of tau_s [s] on the yaw rate."""
    return on_yaw_rate(soft(params["tau_s"], 0.0))


EFFECT = Effect(
    Port.REPORT,
    {"tau_s": 0.0},
    {"tau_s": "s"},
    make,
    "reported yaw rate follows the turn more softly than the INS's, by the same time at every speed",
    priors={"tau_s": Prior(0.02, 0.6, 0.1, "log")},
    impostors=("tyre_relaxation", "report_latency", "ins_latency"),
    manoeuvre="the same steps of the steering at two speeds: the lag is that of a time, and the INS does not have it",
    needs=(Need("steer_moves", 6.0),),
    links=(Link.YAW_VS_INS,),
)
