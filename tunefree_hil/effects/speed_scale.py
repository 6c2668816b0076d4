"""Wrong wheel speed scale or rolling radius: reported speed and wheel speeds are scaled."""

from __future__ import annotations

from tunefree_hil.base.contracts import Block, Effect, Link, Need, Port, Prior
from tunefree_hil.base.kernel import kernel
from tunefree_hil.base.records import Report
from tunefree_hil.effects._reports import replace_sensed
from tunefree_hil.effects._signals import positive


@kernel
def step(params: float, state: float, x: Report, dt_s: float) -> tuple[float, Report]:
    """The report with its speeds scaled."""
    wheels = (
        params * x.wheel_fl_radps,
        params * x.wheel_fr_radps,
        params * x.wheel_rl_radps,
        params * x.wheel_rr_radps,
    )
    return state, replace_sensed(x, x.steer_rad, params * x.speed_mps, wheels, x.accel_mps2, x.yaw_rate_radps)


def make(params: dict[str, float], rest: float) -> Block:
    """Block on Report: scale_frac times the speed and the four wheel speeds."""
    return Block(lambda params, dt_s: 0.0, step, positive("scale_frac", params["scale_frac"], zero=False))


EFFECT = Effect(
    Port.REPORT,
    {"scale_frac": 1.0},
    {"scale_frac": "1"},
    make,
    "reported speed and wheel speeds are a constant factor off the INS's",
    priors={"scale_frac": Prior(0.85, 1.18, 0.97, "log")},
    impostors=("yaw_rate_scale", "steer_gain"),
    manoeuvre="straight on at three speeds: wheels and INS differ by the same share",
    needs=(Need("moving_s", 20.0), Need("top_speed_mps", 5.0)),
    links=(Link.WHEEL_VS_INS,),
)
