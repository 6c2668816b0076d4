"""The net of eq. 1, to be evaluated without torch: two inputs, one hidden layer of sigmoids, one linear output."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

Array = np.ndarray


class Scale(NamedTuple):
    """(value - middle) / span."""

    middle: float
    span: float

    def into(self, value: Array) -> Array:
        """SI -> about -1 to 1."""
        return (value - self.middle) / self.span

    def out(self, value: Array) -> Array:
        """Back to SI."""
        return value * self.span + self.middle


class PedalNet(NamedTuple):
    """Acceleration from speed and the duty of one pedal; its inputs and its output are scaled. Arrays [width]."""

    speed: Scale
    command: Scale
    accel: Scale
    w_speed: Array
    w_command: Array
    bias: Array
    w_out: Array
    b_out: float

    @property
    def width(self) -> int:
        """Hidden units."""
        return len(self.bias)

    def accel_of(self, speed_mps: Array, command_frac: Array) -> Array:
        """m/s2; the arguments have one shape. a = sum w_out sig(w_command u + w_speed v + bias) + b_out (eq. 1)."""
        v, u = self.speed.into(np.asarray(speed_mps)), self.command.into(np.asarray(command_frac))
        inner = v[..., None] * self.w_speed + u[..., None] * self.w_command + self.bias
        hidden = 0.5 + 0.5 * np.tanh(0.5 * inner)  # the sigmoid, without overflow
        return self.accel.out(hidden @ self.w_out + self.b_out)


def merged(nets: Sequence[PedalNet]) -> PedalNet:
    """The mean of nets with the same scales: one net of eq. 1 again, as wide as all of them together."""
    first, share = nets[0], 1.0 / len(nets)
    w_speed, w_command, bias, w_out = (
        np.concatenate([getattr(net, name) for net in nets]) for name in ("w_speed", "w_command", "bias", "w_out")
    )
    b_out = share * sum(net.b_out for net in nets)
    return first._replace(w_speed=w_speed, w_command=w_command, bias=bias, w_out=share * w_out, b_out=b_out)


def scale_of(values: Array) -> Scale:
    """From -1 to 1 over these values."""
    low, high = float(np.min(values)), float(np.max(values))
    return Scale(0.5 * (low + high), max(0.5 * (high - low), 1e-6))
