"""Settings that the plans of both outer loops share: horizon, step, and what stands at its end."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from tunefree_hil.base.contracts import Tunable
from tunefree_hil.base.errors import InputError


class PlanSettings(NamedTuple):
    """Horizon and its first step; whether its end has the cost to go of the LQR."""

    horizon_s: float
    step_s: float
    is_terminal_riccati: bool


class SharedTunables(NamedTuple):
    """Tunables with their default values."""

    tunables: tuple[Tunable, ...]
    defaults: dict[str, float]


HORIZON = SharedTunables(
    (
        Tunable("mpc.horizon_s", "s", 0.05, 3.0, "linear"),
        Tunable("mpc.step_s", "s", 0.01, 0.2, "linear"),
        Tunable("mpc.terminal", "1", 0.0, 1.0, "linear", choices=(0.0, 1.0)),
    ),
    {"mpc.horizon_s": 1.0, "mpc.step_s": 0.01, "mpc.terminal": 1.0},
)
LONGEST_HORIZON_S = 10.0


def plan_settings(values: Mapping[str, float]) -> PlanSettings:
    """The settings from the parameters. Raises InputError for a horizon or a step that is not possible."""
    horizon_s, step_s = values["mpc.horizon_s"], values["mpc.step_s"]
    for name, value in (("mpc.horizon_s", horizon_s), ("mpc.step_s", step_s)):
        if not 0.0 < value <= LONGEST_HORIZON_S:
            hint = f"give a time above 0 and at most {LONGEST_HORIZON_S:g} s"
            raise InputError(f"{name} = {value:g} is not possible", code="bad_parameter", key=name, hint=hint)
    return PlanSettings(horizon_s, step_s, values["mpc.terminal"] != 0.0)


def require_weights(values: Mapping[str, float], inputs: Sequence[str], weights: Sequence[Tunable]) -> None:
    """Raise InputError for a weight below 0, or a weight of an input that is not above 0."""
    for name in (tunable.name for tunable in weights):
        value = values[name]
        if not (math.isfinite(value) and value >= 0.0 and (value > 0.0 or name not in inputs)):
            hint = "give a number above 0" if name in inputs else "give 0 or a number above it"
            raise InputError(f"{name} = {value:g} is no weight", code="bad_parameter", key=name, hint=hint)
