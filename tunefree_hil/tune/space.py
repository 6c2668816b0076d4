"""The search space: parameters with a range, and their values in binary32.

A parameter is sent to the controller as IEEE 754 binary32. So the edges of a range are rounded inward to binary32 and
every value is rounded to binary32 before it is stored or scored: study, bus and controller then have the same number.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution

from tunefree_hil.base.contracts import Tunable
from tunefree_hil.base.errors import InputError
from tunefree_hil.control.parameters import BY_NAME, LARGEST32, SETS, Box, BoxChoice, box32, round32, tunable_in_box

MOST_GRID_POINTS = 100_000


class SearchedParameter(Box, Protocol):
    """What a search needs of a parameter: a Tunable of a controller, or a ParameterSpec of a bench file."""

    @property
    def name(self) -> str: ...
    @property
    def step(self) -> float | None: ...


class Axis(NamedTuple):
    """One searched parameter; every number is a binary32.

    grid: Its values, ascending, where only some are allowed.
    choices: The values of `grid` have no order (a switch), so a sampler must not interpolate between them.
    """

    name: str
    low: float
    high: float
    log: bool
    grid: tuple[float, ...] = ()
    choices: bool = False

    def clip(self, value: float) -> float:
        """The allowed binary32 nearest to `value`. Raises InputError for NaN."""
        if math.isnan(value):
            raise InputError(f"{self.name} is not a number", code="bad_parameter", key=self.name)
        if self.grid:
            return min(self.grid, key=lambda point: abs(point - value))
        return round32(min(max(value, self.low), self.high))

    def sampler_distribution(self) -> BaseDistribution:
        """The distribution of the sampler: values of a grid by their index, which is exact."""
        if self.grid and not self.choices:
            return IntDistribution(0, len(self.grid) - 1)
        return self.stored_distribution()

    def stored_distribution(self) -> BaseDistribution:
        """The distribution in the study file: the values themselves."""
        if self.choices:
            return CategoricalDistribution(self.grid)
        return FloatDistribution(self.low, self.high, log=self.log)

    def to_sampler(self, value: float) -> float | int:
        """An allowed value as a value of `sampler_distribution`."""
        return self.grid.index(self.clip(value)) if self.grid and not self.choices else self.clip(value)

    def from_sampler(self, drawn: float | int) -> float:
        """A value of `sampler_distribution` as an allowed value."""
        return self.grid[int(drawn)] if self.grid and not self.choices else self.clip(float(drawn))


class Space(NamedTuple):
    """The axes of a search, in the order in which they were listed."""

    axes: tuple[Axis, ...]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(axis.name for axis in self.axes)

    def clip(self, values: Mapping[str, float]) -> dict[str, float]:
        """The values of all axes, each clipped to its range and rounded to binary32; other names are left out.

        Raises InputError for an axis without a value.
        """
        missing = [name for name in self.names if name not in values]
        if missing:
            raise InputError(f"no value for {', '.join(missing)}", code="bad_parameter", key=missing[0])
        return {axis.name: axis.clip(float(values[axis.name])) for axis in self.axes}

    def as_data(self) -> dict[str, dict[str, Any]]:
        """Plain data by parameter name, for the settings of a study; `space_from_data` is the inverse."""
        return {
            axis.name: {
                "low": axis.low,
                "high": axis.high,
                "scale": "log" if axis.log else "linear",
                "grid": list(axis.grid),
                "choices": axis.choices,
            }
            for axis in self.axes
        }


def space_from_data(data: Mapping[str, Mapping[str, Any]]) -> Space:
    """The inverse of `Space.as_data`."""
    return Space(
        tuple(
            Axis(name, d["low"], d["high"], d["scale"] == "log", tuple(d["grid"]), d["choices"])
            for name, d in data.items()
        )
    )


def make_space(parameters: Iterable[SearchedParameter], *, scale: str = "", file: str = "") -> Space:
    """Make the space of these parameters.

    Args:
        parameters: Parameters with their ranges.
        scale: "log" or "linear" overrides the scale of the parameters.
        file: Named in error messages.

    Raises:
        InputError: Duplicate name, empty range, log scale that reaches 0, or steps on a log scale.
    """
    axes = tuple(_axis(parameter, scale or parameter.scale, file) for parameter in parameters)
    for i, axis in enumerate(axes):
        if axis.name in {other.name for other in axes[:i]}:
            raise _wrong(file, axis.name, "is listed twice", "list every parameter once")
    if not axes:
        raise _wrong(file, "", "nothing to tune", f"give a set ({', '.join(SETS)}) or parameters")
    return Space(axes)


def resolve_space(
    set_name: str,
    specs: Sequence[SearchedParameter],
    *,
    announced: Iterable[Tunable] = (),
    scale: str = "",
    box: BoxChoice = BoxChoice.PAPER,
    file: str = "",
) -> Space:
    """Make the space of `[tune]` of a bench file: a set (docs/reference/controller.md), listed parameters, or both.

    Args:
        set_name: A name of SETS; '' for listed parameters alone.
        specs: Listed parameters; one without range and choices takes those of the table.
        announced: Parameters that a foreign controller announces, in addition to the table.
        scale: "log" or "linear" overrides the scale of the parameters.
        box: Which range the parameters of the table have.
        file: Named in error messages.

    Raises:
        InputError: It names file and key.
    """
    table = {
        **{name: tunable_in_box(name, box) for name in BY_NAME},
        **{tunable.name: tunable for tunable in announced},
    }
    if set_name and set_name not in SETS:
        raise _wrong(file, "", f"has an unknown set {set_name!r}", f"use {', '.join(SETS)}")
    listed = [_with_box(spec, table, file) for spec in specs]
    return make_space([*(table[name] for name in SETS.get(set_name, ())), *listed], scale=scale, file=file)


def _with_box(spec: SearchedParameter, table: Mapping[str, Tunable], file: str) -> SearchedParameter:
    """`spec` with the range or the choices of the table where it has none."""
    if spec.low != 0.0 or spec.high != 0.0 or spec.choices:
        return spec
    if spec.name not in table:
        raise _wrong(file, spec.name, "is unknown and has no range", f"give low and high, or tune {', '.join(table)}")
    known = table[spec.name]  # in a bench file "log" is the default, so only "linear" is certainly meant
    scale = spec.scale if spec.step is not None or spec.scale == "linear" else known.scale
    return known._replace(scale="linear" if scale == "linear" else "log", step=spec.step)


def _axis(parameter: SearchedParameter, scale: str, file: str) -> Axis:
    name, step, choices = parameter.name, parameter.step, parameter.choices
    if scale not in ("log", "linear"):
        raise _wrong(file, name, f"has scale {scale!r}", 'use "log" or "linear"')
    if choices:
        return _choice_axis(name, choices, step, file)
    low, high = _inward32(parameter.low, parameter.high, name, file)
    log = scale == "log"
    if step is not None:
        if log:
            raise _wrong(file, name, "has steps on a log scale", 'set scale = "linear", or list the values as choices')
        return Axis(name, low, high, False, _grid(parameter, step, (low, high), file))
    if log and low <= 0.0:
        raise _wrong(file, name, f"is searched on a log scale from {parameter.low:g}", "set low above 0")
    return Axis(name, low, high, log)


def _choice_axis(name: str, choices: Sequence[float], step: float | None, file: str) -> Axis:
    values = tuple(sorted({round32(value) for value in choices if abs(value) < LARGEST32}))
    if step is not None or len(values) < 2 or len(values) < len(choices):
        raise _wrong(file, name, "needs two or more different finite choices, and no step", "correct `choices`")
    return Axis(name, values[0], values[-1], False, values, True)


def _grid(parameter: SearchedParameter, step: float, box: tuple[float, float], file: str) -> tuple[float, ...]:
    """low, low + step, ... as binary32 within `box`: the range of the parameter, rounded inward."""
    if not (math.isfinite(step) and step > 0.0):
        raise _wrong(file, parameter.name, f"has step {step:g}", "give a step above 0")
    steps = (parameter.high - parameter.low) / step
    if not 1.0 - 1e-9 <= steps < MOST_GRID_POINTS:
        hint = f"have 2 to {MOST_GRID_POINTS} values"
        raise _wrong(file, parameter.name, f"has step {step:g} in a range of {parameter.high - parameter.low:g}", hint)
    points = (parameter.low + k * step for k in range(math.floor(steps + 1e-9) + 1))
    return tuple(sorted({round32(min(max(point, box[0]), box[1])) for point in points}))


def _inward32(low: float, high: float, name: str, file: str) -> tuple[float, float]:
    """The range as rounded by `box32`, which must have two values or more."""
    if not max(abs(low), abs(high)) < LARGEST32:  # NaN too
        raise _wrong(file, name, f"has the range {low:g} to {high:g}", "give finite edges that fit binary32")
    box = box32(low, high) if round32(low) < round32(high) else (low, low)
    if not box[0] < box[1]:
        hint = "set low below high; a value that is not searched belongs in [controller.parameters]"
        raise _wrong(file, name, f"has an empty range, {low:g} to {high:g}", hint)
    return box


def _wrong(file: str, name: str, message: str, hint: str) -> InputError:
    key = f"tune.parameters {name}" if name else "tune"
    return InputError(f"{name or 'tune'} {message}", code="bad_parameter", file=file, key=key, hint=hint)
