"""What is searched: numbers with a box, and their places on the wire (design D13, interfaces 7 and 8).

A parameter travels to the controller as IEEE 754 binary32, so box edges are rounded *inward* to binary32 and every
value is rounded to binary32 before anybody stores or judges it: study, wire and controller then hold the same number.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution

from tunefree_hil.base.contracts import Tunable
from tunefree_hil.base.errors import InputError
from tunefree_hil.control.parameters import BY_NAME, LARGEST32, SETS, Box, box32, round32

MOST_GRID_POINTS = 100_000


class Searched(Box, Protocol):
    """What a search must know of a parameter: a Tunable of a controller, or a ParameterSpec of a bench file."""

    @property
    def name(self) -> str: ...
    @property
    def step(self) -> float | None: ...


class Axis(NamedTuple):
    """One searched parameter; every number in it is a binary32. `grid`: its values, ascending, where they are stepped.

    `choices`: the values in `grid` are kinds without an order (a switch); a sampler must not interpolate between them.
    """

    name: str
    low: float
    high: float
    log: bool
    grid: tuple[float, ...] = ()
    choices: bool = False

    def fit(self, value: float) -> float:
        """The admissible binary32 nearest to `value`. Raises InputError when it is not a number."""
        if math.isnan(value):
            raise InputError(f"{self.name} is not a number", code="bad_parameter", key=self.name)
        if self.grid:
            return min(self.grid, key=lambda point: abs(point - value))
        return round32(min(max(value, self.low), self.high))

    def sampled(self) -> BaseDistribution:
        """The distribution a sampler works in: stepped values by their place in the grid, which is exact."""
        if self.grid and not self.choices:
            return IntDistribution(0, len(self.grid) - 1)
        return self.stored()

    def stored(self) -> BaseDistribution:
        """The distribution the study file shows: the values themselves."""
        if self.choices:
            return CategoricalDistribution(self.grid)
        return FloatDistribution(self.low, self.high, log=self.log)

    def to_sampler(self, value: float) -> float | int:
        """An admissible value as `sampled` counts it."""
        return self.grid.index(self.fit(value)) if self.grid and not self.choices else self.fit(value)

    def from_sampler(self, drawn: float | int) -> float:
        """What a sampler drew from `sampled`, as an admissible value."""
        return self.grid[int(drawn)] if self.grid and not self.choices else self.fit(float(drawn))


class Space(NamedTuple):
    """The axes of a search, in the order in which they are asked for."""

    axes: tuple[Axis, ...]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(axis.name for axis in self.axes)

    def fit(self, values: Mapping[str, float]) -> dict[str, float]:
        """`values` of all axes, each put into the box on its own and rounded to binary32; other names are left out.

        Raises InputError when an axis has no value.
        """
        missing = [name for name in self.names if name not in values]
        if missing:
            raise InputError(f"no value for {', '.join(missing)}", code="bad_parameter", key=missing[0])
        return {axis.name: axis.fit(float(values[axis.name])) for axis in self.axes}

    def described(self) -> dict[str, dict[str, Any]]:
        """The space as plain data by parameter name, for the study's settings; `from_description` reads it back."""
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


def from_description(described: Mapping[str, Mapping[str, Any]]) -> Space:
    """The inverse of `Space.described`."""
    return Space(
        tuple(
            Axis(name, d["low"], d["high"], d["scale"] == "log", tuple(d["grid"]), d["choices"])
            for name, d in described.items()
        )
    )


def make_space(parameters: Iterable[Searched], *, scale: str = "", file: str = "") -> Space:
    """A space of these parameters; `scale` ("log" or "linear") overrides theirs. `file` is named in mistakes.

    Raises InputError for a name twice, an empty box, a log scale that reaches 0, or steps on a log scale.
    """
    axes = tuple(_axis(parameter, scale or parameter.scale, file) for parameter in parameters)
    for i, axis in enumerate(axes):
        if axis.name in {other.name for other in axes[:i]}:
            raise _wrong(file, axis.name, "is asked for twice", "list every parameter once")
    if not axes:
        raise _wrong(file, "", "there is nothing to tune", f"give a set ({', '.join(SETS)}) or parameters")
    return Space(axes)


def resolve(
    set_name: str, specs: Sequence[Searched], *, own: Iterable[Tunable] = (), scale: str = "", file: str = ""
) -> Space:
    """The space that a bench file's `[tune]` asks for: a named set of interfaces 7, or a list of parameters.

    A listed parameter that gives neither box nor choices takes those of the table, or of `own`: what a user's own
    controller announces. Raises InputError that names file and key.
    """
    table = {**{name: row.tunable for name, row in BY_NAME.items()}, **{tunable.name: tunable for tunable in own}}
    if set_name and specs:
        raise _wrong(file, "", "has both `set` and `parameters`", "keep one of the two")
    if set_name and set_name not in SETS:
        raise _wrong(file, "", f"knows no set {set_name!r}", f"use {', '.join(SETS)}")
    if set_name:
        return make_space([table[name] for name in SETS[set_name]], scale=scale, file=file)
    return make_space([_with_box(spec, table, file) for spec in specs], scale=scale, file=file)


def _with_box(spec: Searched, table: Mapping[str, Tunable], file: str) -> Searched:
    """`spec`, with the table's box or choices where it gives none."""
    if spec.low != 0.0 or spec.high != 0.0 or spec.choices:
        return spec
    if spec.name not in table:
        raise _wrong(file, spec.name, "is not known and has no box", f"give low and high, or tune {', '.join(table)}")
    found = table[spec.name]  # of a bench file "log" is the default, so only "linear" is sure to be meant
    scale = spec.scale if spec.step is not None or spec.scale == "linear" else found.scale
    return found._replace(scale="linear" if scale == "linear" else "log", step=spec.step)


def _axis(parameter: Searched, scale: str, file: str) -> Axis:
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


def _grid(parameter: Searched, step: float, box: tuple[float, float], file: str) -> tuple[float, ...]:
    """low, low + step, ... as binary32 within `box`, the parameter's own box rounded inward."""
    if not (math.isfinite(step) and step > 0.0):
        raise _wrong(file, parameter.name, f"has step {step:g}", "give a step above 0")
    steps = (parameter.high - parameter.low) / step
    if not 1.0 - 1e-9 <= steps < MOST_GRID_POINTS:
        hint = f"have 2 to {MOST_GRID_POINTS} values"
        raise _wrong(file, parameter.name, f"has step {step:g} in a box {parameter.high - parameter.low:g} wide", hint)
    points = (parameter.low + k * step for k in range(math.floor(steps + 1e-9) + 1))
    return tuple(sorted({round32(min(max(point, box[0]), box[1])) for point in points}))


def _inward32(low: float, high: float, name: str, file: str) -> tuple[float, float]:
    """The box as `box32` rounds it, which must have room for two values."""
    if not max(abs(low), abs(high)) < LARGEST32:  # NaN too
        raise _wrong(file, name, f"has the box {low:g} to {high:g}", "give finite edges that fit binary32")
    box = box32(low, high) if round32(low) < round32(high) else (low, low)
    if not box[0] < box[1]:
        hint = "set low below high; a value that is not searched belongs in [controller.parameters]"
        raise _wrong(file, name, f"has an empty box, {low:g} to {high:g}", hint)
    return box


def _wrong(file: str, name: str, message: str, hint: str) -> InputError:
    key = f"tune.parameters {name}" if name else "tune"
    return InputError(f"{name or 'tune'} {message}", code="bad_parameter", file=file, key=key, hint=hint)
