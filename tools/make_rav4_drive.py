#!/usr/bin/env python3
"""Make bench_configs/scenarios/rav4_drive.toml: the speed and path that a real car drove, from its CAN log.

    python tools/make_rav4_drive.py [--log ../shared/data/comma2k19_rav4/drive.candump.log] [--dbc ...] [--out FILE]

Speed from SPEED (0x0B4), path from the steering wheel's angle STEER_ANGLE + STEER_FRACTION (0x025) with the car's
ratio and wheelbase (kinematic). Only the part driven by the car's own cruise control is kept: what a controller can
be held against. Smoothed without lag (Gaussian) and decimated to breakpoints.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import Any

import cantools
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from tunefree_hil.base.errors import InputError  # noqa: E402
from tunefree_hil.base.units import KPH_PER_MPS, RAD_PER_DEG  # noqa: E402
from tunefree_hil.episode.candump import LogFrame, read_candump  # noqa: E402

DATA = ROOT.parent / "shared" / "data" / "comma2k19_rav4"
STEER_RATIO, WHEELBASE_M = 14.5, 2.66  # of the RAV4, README of the data
SMOOTH_S = 0.4  # standard deviation of the Gaussian
BREAKPOINT_S = 0.5
GRID_S = 0.02
CAR_BUS = "can0"

HEAD = """\
# A real drive: Toyota RAV4 (2017) on a road, driven by its cruise control and lane keeping, {duration:.1f} s.
# Speed from CAN message 0x0B4, path from the steering-wheel angle of 0x025 (ratio {ratio}, wheelbase {wheelbase} m),
# smoothed (Gaussian, {smooth} s) and decimated to {step} s by tools/make_rav4_drive.py; do not edit by hand.
# Data: comma2k19, Example_1, drive 2018-08-02--08-34-47, segment 40; copyright (c) 2018 comma.ai, MIT licence.
schema = "tunefree.scenario/1"
name = "rav4_drive"
description = "A real drive (comma2k19 RAV4): {slow:.0f} to {fast:.0f} m/s with gentle bends, longitudinal check"
noise_seed = 31
start = {{ lateral_m = 0.0, heading_rad = 0.0, speed_mps = {first!r} }}
"""


def main() -> int:
    """Read, convert, write; 2 when an input does not fit."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--log", type=Path, default=DATA / "drive.candump.log")
    parser.add_argument("--dbc", type=Path, default=DATA / "rav4.dbc")
    parser.add_argument("--out", type=Path, default=ROOT / "bench_configs" / "scenarios" / "rav4_drive.toml")
    options = parser.parse_args()
    try:
        text = scenario_text(options.log, options.dbc)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    options.out.write_text(text)
    print(f"wrote {options.out}")
    return 0


def scenario_text(log: Path, dbc: Path) -> str:
    """The TOML file's text. Raises InputError for a missing file or a log without the messages."""
    if not dbc.is_file():
        raise InputError("there is no such DBC", file=str(dbc), hint="give it with --dbc")
    network = cantools.database.load_file(dbc)
    frames = [frame for frame in read_candump(log) if frame.channel == CAR_BUS]
    time, speed = signals(network, frames, log, "SPEED", "SPEED")
    steer_time, *angle = signals(network, frames, log, "STEER_ANGLE_SENSOR", "STEER_ANGLE", "STEER_FRACTION")
    cruise_time, active = signals(network, frames, log, "PCM_CRUISE", "CRUISE_ACTIVE")
    begin_s, end_s = longest_run(cruise_time, active > 0.5, min(time[-1], steer_time[-1]))
    steer_rad = (angle[0] + angle[1]) * RAD_PER_DEG
    curvature = np.tan(steer_rad / STEER_RATIO) / WHEELBASE_M
    at = np.arange(begin_s, end_s, BREAKPOINT_S)
    return _toml(
        [round(BREAKPOINT_S * i, 2) for i in range(len(at))],
        np.round(smoothed(time, speed / KPH_PER_MPS, at), 3).tolist(),
        (np.round(smoothed(steer_time, curvature, at), 6) + 0.0).tolist(),
    )


def signals(network: Any, frames: list[LogFrame], log: Path, name: str, *fields: str) -> list[np.ndarray]:
    """[times from the log's start, values of each signal ...]; frames too short for a signal are left out."""
    message = network.get_message_by_name(name)
    rows = []
    for frame in frames:
        if frame.can_id == message.frame_id:
            values = message.decode(frame.data, decode_choices=False, allow_truncated=True)
            if all(field in values for field in fields):
                rows.append((frame.time_s - frames[0].time_s, *(values[field] for field in fields)))
    if not rows:
        raise InputError(f"no frame of {name} (0x{message.frame_id:X}) on {CAR_BUS}", file=str(log))
    return list(np.array(rows, dtype=float).T)


def longest_run(time: np.ndarray, on: np.ndarray, end_s: float) -> tuple[float, float]:
    """(begin, end) of the longest time during which `on` held."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], on.astype(int), [0]])))
    ends = np.minimum(np.append(time, end_s), end_s)
    spans = [(float(time[a]), float(ends[b])) for a, b in edges.reshape(-1, 2)]
    if not spans:
        raise InputError("the cruise control was never active in this log")
    return max(spans, key=lambda span: span[1] - span[0])


def smoothed(time: np.ndarray, values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Values at the times `at` after a Gaussian without lag; at the ends the window is cut and renormalised."""
    grid = np.arange(time[0], time[-1], GRID_S)
    even = np.interp(grid, time, values)
    reach = math.ceil(4.0 * SMOOTH_S / GRID_S)
    window = np.exp(-0.5 * (np.arange(-reach, reach + 1) * GRID_S / SMOOTH_S) ** 2)
    weight = np.convolve(np.ones_like(even), window, mode="same")
    return np.interp(at, grid, np.convolve(even, window, mode="same") / weight)


def _toml(times: list[float], speed: list[float], curvature: list[float]) -> str:
    head = HEAD.format(
        duration=times[-1],
        ratio=STEER_RATIO,
        wheelbase=WHEELBASE_M,
        smooth=SMOOTH_S,
        step=BREAKPOINT_S,
        slow=min(speed),
        fast=max(speed),
        first=speed[0],
    )
    profiles = (("speed", speed), ("curvature", curvature))
    return head + "".join(f"\n[{key}]\nt_s = {_row(times)}\nvalue = {_row(values)}\n" for key, values in profiles)


def _row(values: list[float]) -> str:
    lines = [", ".join(_number(value) for value in values[i : i + 10]) for i in range(0, len(values), 10)]
    return "[\n" + "".join(f"    {line},\n" for line in lines) + "]"


def _number(value: float) -> str:
    digits = f"{value:.6f}".rstrip("0")
    return digits + "0" if digits.endswith(".") else digits


if __name__ == "__main__":
    sys.exit(main())
