"""The parameters of docs/reference/controller.md: index on the bench channel, name, box, unit and manual value; sets
and baselines."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import NamedTuple, Protocol

from tunefree_hil.base.contracts import Tunable
from tunefree_hil.base.errors import InputError


class Box(Protocol):
    """Range of a parameter: a Tunable, or an entry of [tune] in a bench file."""

    @property
    def low(self) -> float: ...

    @property
    def high(self) -> float: ...

    @property
    def scale(self) -> str: ...

    @property
    def choices(self) -> Sequence[float] | None: ...


class BoxChoice(StrEnum):
    """Which box a parameter is searched in; the value stands in a bench file."""

    PAPER = "paper"  # as published
    DEFAULT = "default"  # the wider one of WIDER_BOXES, which needs requirements that hold it in check


class Parameter(NamedTuple):
    """One row; the box of its tunable is the published one.

    manual: Apollo's MKZ value. fixed: The value in a study that does not tune it; None: manual.
    """

    index: int
    tunable: Tunable
    manual: float
    fixed: float | None = None


PARAMETERS: tuple[Parameter, ...] = (
    Parameter(0, Tunable("mrac.t_ref_s", "s", 0.01, 0.26), 0.09),
    Parameter(1, Tunable("mrac.p", "1", 1e-4, 0.1), 1e-4),
    Parameter(2, Tunable("lqr.q1", "1", 0.01, 1.0), 0.05),
    Parameter(3, Tunable("lqr.q2", "1", 0.001, 0.1), 0.0),
    Parameter(4, Tunable("lqr.q3", "1", 0.01, 1.0), 1.0),
    Parameter(5, Tunable("lqr.q4", "1", 0.001, 0.1), 0.0),
    Parameter(6, Tunable("station.kp", "1/s", 0.01, 1.0), 0.2),
    Parameter(7, Tunable("speed.kp_low", "1/s", 0.1, 10.0), 2.0),
    Parameter(8, Tunable("speed.ki_low", "1/s2", 0.01, 1.0), 0.3),
    Parameter(9, Tunable("speed.kp_high", "1/s", 0.1, 10.0), 1.0),
    Parameter(10, Tunable("speed.ki_high", "1/s2", 0.01, 1.0), 0.3),
    Parameter(11, Tunable("mrac.enable", "1", 0.0, 1.0, "linear", choices=(0.0, 1.0)), 0.0, 1.0),
    Parameter(12, Tunable("riccati", "1", 0.0, 1.0, "linear", choices=(0.0, 1.0)), 0.0),
    Parameter(13, Tunable("mrac.clamp_s", "s", 0.01, 0.26), 0.08, 0.01),
    Parameter(14, Tunable("mrac.gamma", "1", 1e-4, 1.0), 1.0),
    Parameter(15, Tunable("look_ahead_m", "m", 0.0, 5.0, "linear"), 0.0),
)
LARGEST32 = 3.4028234e38  # of PARAM's binary32 (docs/reference/bench_channel.md), rounded down
FIRST_OWN_INDEX = 16  # first index for parameters of a user's controller
BY_NAME: dict[str, Parameter] = {row.tunable.name: row for row in PARAMETERS}
NAMES: tuple[str, ...] = tuple(BY_NAME)
SETS: dict[str, tuple[str, ...]] = {"mrac": NAMES[0:2], "lateral": NAMES[0:6], "complete": NAMES[0:11]}

# Mostly wider than the published box: (low, high). An edge without a reason here is the published one. Where a low edge
# is below it, the published one is too high for a vehicle with long dead times: see `rule_based` (tune/baselines.py).
WIDER_BOXES: dict[str, tuple[float, float]] = {
    "mrac.t_ref_s": (0.01, 0.5),  # a steering three times as slow as the van's, the slowest here
    "mrac.p": (1e-6, 0.1),  # at 1e-6 nothing adapts within a drive: practically off
    # Low: the loop keeps a phase margin of 45 degrees at 30 m/s with 0.3 s of dead time and lag, as the van's.
    # High: K1 is about sqrt(Q1): an error of 0.5 m takes the front wheels to the stop of a passenger car, 0.5 rad.
    "lqr.q1": (1e-4, 1.0),
    "lqr.q2": (1e-6, 0.1),  # K2 is at most sqrt(Q2): 0.001 rad per m/s, less than backlash
    "lqr.q3": (1e-4, 4.0),  # low as Q1; high: 15 degrees of heading error take the front wheels to the stop
    "lqr.q4": (1e-6, 0.1),  # as Q2
    "station.kp": (0.01, 1.5),  # SIMC with a delay of 0.1 s, the shortest of a drive: 1 / (6.5 * 0.1)
    # SIMC with a delay of 0.125 s. Driveline and pedals together show 0.25 s; `speed.predict` takes a part of that out
    # of the loop. With 5 the pedals of a winner took turns at 2 m/s
    "speed.kp_low": (0.1, 4.0),
    "speed.kp_high": (0.1, 4.0),
    "speed.ki_low": (1e-3, 1.0),  # low: no integral within a drive
    "speed.ki_high": (1e-3, 1.0),
}

HALF_WHEELBASE_M = 1.4224  # look-ahead as shipped (docs/reference/apollo.md)
RICCATI_CODES = {"converged": 0.0, "apollo150": 1.0}

_AS_SHIPPED = {row.tunable.name: row.manual for row in PARAMETERS}
_MRAC_ON = {**_AS_SHIPPED, "mrac.enable": 1.0}
BASELINES: dict[str, dict[str, float]] = {
    "as_shipped": _AS_SHIPPED,
    "mrac_on": _MRAC_ON,
    "as_shipped_look_ahead": {**_AS_SHIPPED, "look_ahead_m": HALF_WHEELBASE_M},
    "mrac_on_look_ahead": {**_MRAC_ON, "look_ahead_m": HALF_WHEELBASE_M},
}


def study_values() -> dict[str, float]:
    """A complete vector to start a study's trial from: manual gains, MRAC on, gamma 1, clamp 0.01 s
    (docs/reference/controller.md)."""
    return {row.tunable.name: row.manual if row.fixed is None else row.fixed for row in PARAMETERS}


def tunable_in_box(name: str, box: BoxChoice) -> Tunable:
    """The tunable of a parameter of the table, with the chosen box."""
    tunable = BY_NAME[name].tunable
    if box is BoxChoice.PAPER or name not in WIDER_BOXES:
        return tunable
    low, high = WIDER_BOXES[name]
    return tunable._replace(low=low, high=high)


def tunables_of(prefix: str) -> tuple[Tunable, ...]:
    """The tunables whose name starts with `prefix`."""
    return tuple(row.tunable for row in PARAMETERS if row.tunable.name.startswith(prefix))


def middle_of(box: Box) -> float:
    """The middle of a box on its scale; of choices the first."""
    if box.choices:
        return box.choices[0]
    return math.sqrt(box.low * box.high) if box.scale == "log" else 0.5 * (box.low + box.high)


def round32(value: float) -> float:
    """The nearest IEEE 754 binary32 number: as in a PARAM frame (docs/reference/bench_channel.md)."""
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


def box32(low: float, high: float) -> tuple[float, float]:
    """The box rounded inward to binary32, so that a rounded point of it is in the box."""
    inner_low, inner_high = round32(low), round32(high)
    if inner_low < low:
        inner_low = _step32(inner_low, upward=True)
    if inner_high > high:
        inner_high = _step32(inner_high, upward=False)
    if inner_low > inner_high:
        raise InputError(
            f"no binary32 number lies between {low!r} and {high!r}",
            code="empty_box",
            hint="widen the box of this parameter, or fix it",
        )
    return inner_low, inner_high


def _step32(value: float, *, upward: bool) -> float:
    """The next binary32 number after the binary32 number `value`."""
    if value == 0.0:
        tiny = struct.unpack("<f", struct.pack("<I", 1))[0]
        return tiny if upward else -tiny
    (bits,) = struct.unpack("<I", struct.pack("<f", value))
    away_from_zero = (value > 0.0) == upward
    return float(struct.unpack("<f", struct.pack("<I", bits + (1 if away_from_zero else -1)))[0])


def check_complete(values: Mapping[str, float], own_names: tuple[str, ...] = ()) -> dict[str, float]:
    """`values` as floats. Raises InputError unless it names exactly every parameter (and `own`, of the user)."""
    known = NAMES + own_names
    missing = [name for name in known if name not in values]
    unknown = [name for name in values if name not in known]
    if missing or unknown:
        parts = [f"missing: {', '.join(missing)}"] if missing else []
        parts += [f"unknown: {', '.join(unknown)}"] if unknown else []
        raise InputError(
            f"the parameter vector does not fit; {'; '.join(parts)}",
            code="bad_parameters",
            hint=f"the parameters are {', '.join(known)}",
        )
    for name in known:
        if not math.isfinite(values[name]):
            raise InputError(f"{name} = {values[name]} is not a number", code="bad_parameters", key=name)
    return {name: float(values[name]) for name in known}


def indices_of(own_names: Sequence[str] = ()) -> dict[str, int]:
    """The PARAM index of every parameter by name: docs/reference/controller.md, then `own` in the order in which it
    is announced."""
    return {name: index for index, name in [*enumerate(NAMES), *enumerate(own_names, FIRST_OWN_INDEX)]}


def by_index(values: Mapping[int, float], own_names: Sequence[str] = ()) -> dict[str, float]:
    """A vector by name from one by PARAM index; indices that are neither in docs/reference/controller.md nor of `own`
    are left out."""
    return {name: float(values[index]) for name, index in indices_of(own_names).items() if index in values}
