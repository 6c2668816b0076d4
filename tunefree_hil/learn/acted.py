"""What acted on a car in each tick, as far as a drive says: commands moved to where they act, and reported outputs."""

from __future__ import annotations

import numpy as np

from tunefree_hil.learn.drives import Array, Drive
from tunefree_hil.learn.pairs import BENCH_TICKS, CHANNELS, ECHOES, by_echo, shifted
from tunefree_hil.learn.smooth import between_fresh
from tunefree_hil.plant.asked_accel import FULL_MPS2


def channel_of(drive: Drive, name: str, rest: float) -> tuple[Array, Array, Array]:
    """(command, recorded output, obeyed) of a channel over a whole drive, as they act."""
    asked, said = drive.get(f"command.{CHANNELS[name]}"), drive.get(f"report.{CHANNELS[name]}")
    echo = drive.get(f"report.{ECHOES[name]}")
    none = np.full(drive.ticks, np.nan)
    output = none if said is None else between_fresh(said, drive.fresh[f"report.{CHANNELS[name]}"])
    if asked is None and said is None:  # a vehicle without this pedal
        return np.full(drive.ticks, rest), none, np.ones(drive.ticks, dtype=bool)
    if echo is not None:
        command = by_echo(echo, drive.fresh[f"report.{ECHOES[name]}"], asked, drive.dt_s)
        # a person at the wheel moves the output, and the echo of what is commanded may stay at rest
        return command, output, np.isfinite(command) & (drive.enabled | ~np.isfinite(output))
    if asked is None:
        return none, output, np.zeros(drive.ticks, dtype=bool)
    command = shifted(asked, BENCH_TICKS)
    return command, output, np.isfinite(command) & drive.enabled


def accel_asked(drive: Drive) -> Array | None:
    """The acceleration that acts in each tick as it was asked for, of a car that is driven so and shows no pedals."""
    asked, echo = drive.get("command.accel_mps2"), drive.get(f"report.{ECHOES['accel']}")
    if any(drive.get(f"{group}.throttle_frac") is not None for group in ("command", "report")):
        return None
    if echo is not None:
        return by_echo(echo, drive.fresh[f"report.{ECHOES['accel']}"], asked, drive.dt_s)
    return None if asked is None else shifted(asked, BENCH_TICKS)


def asked_pedals(asked: Array, enabled: Array, rest: float) -> list[tuple[Array, Array, Array]]:
    """Throttle and brake as `channel_of` has them, of a car that is asked for an acceleration."""
    none, obeyed = np.full(len(asked), np.nan), np.isfinite(asked) & enabled
    throttle, brake = np.maximum(asked, 0.0), np.maximum(-asked, 0.0)
    return [(rest + pedal / FULL_MPS2, none, obeyed) for pedal in (throttle, brake)]
