"""A drive as a CAN log (candump text), and a car as a vehicle folder: exactly what a real car would give."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tools.gap_exam.car import Noise, Vehicle
from tools.gap_exam.layout import ABSENT, MESSAGES, Message, Signal, bounds, dbc, fields
from tools.gap_exam.simulate import ROWS, Drive

EPOCH_S = 1_700_000_000  # plus hours of the seed's: nothing but a date
JITTER_S = 60e-6
TICK_MS = 10
Array = np.ndarray


def noise_rows(noise: Noise, ticks: int, rng: np.random.Generator) -> Array:
    """White noise [ticks, 20] in the order of a drive's reports; echoes of commands have none."""
    n = noise
    pedals = (0.0, n.pedal_frac, 0.0, n.pedal_frac, 0.0, n.steer_rad)
    chassis = (n.speed_mps, *(n.wheel_radps,) * 4, n.accel_mps2, n.accel_mps2, n.yaw_radps)
    ins = (n.ins_m, n.ins_m, n.ins_heading_rad, n.ins_speed_mps, n.ins_accel_mps2, n.ins_yaw_radps)
    sigma = np.array((*pedals, *chassis, *ins))
    assert len(sigma) == ROWS
    return sigma * rng.standard_normal((ticks, ROWS))


def log_text(drive: Drive, rest_frac: float, rng: np.random.Generator) -> str:
    """The log of a drive. Stamps, ids and lengths depend on the generator and the number of ticks alone."""
    ticks = len(drive.commands)
    zero_s = EPOCH_S + 3600 * int(rng.integers(0, 20000))
    times, lines = [], []
    for message in MESSAGES:
        every = message.period_ms // TICK_MS
        k = np.arange(int(rng.integers(0, every)), ticks, every)
        stamp_us = np.rint(k * 1e3 * TICK_MS + 1e3 * message.offset_ms + 1e6 * JITTER_S * rng.random(len(k)))
        payload = pack(message, drive, rest_frac, k)
        head = f" can0 {message.can_id:03X}#"
        whole, micro = np.divmod(stamp_us.astype(np.int64), 1_000_000)
        lines += [
            f"({zero_s + s}.{us:06d}){head}{payload[16 * i : 16 * i + 16]}"
            for i, (s, us) in enumerate(zip(whole.tolist(), micro.tolist(), strict=True))
        ]
        times.append(stamp_us)
    order = np.argsort(np.concatenate(times), kind="stable")
    return "\n".join([lines[i] for i in order.tolist()]) + "\n"


def pack(message: Message, drive: Drive, rest_frac: float, k: Array) -> str:
    """Payloads of a message at ticks k, 16 hex digits each."""
    raw = np.zeros(len(k), dtype=np.uint64)
    for one in message.signals:
        low, high = bounds(one)
        value = np.clip(physical(one, drive, rest_frac, k), low, high)
        number = np.rint(value / one.factor).astype(np.int64) & ((1 << one.bits) - 1)
        raw |= number.astype(np.uint64) << np.uint64(one.start)
    return raw.astype("<u8").tobytes().hex().upper()


def physical(one: Signal, drive: Drive, rest_frac: float, k: Array) -> Array:
    """A signal's physical values: of a report (p: pedal above rest), a command (d: pedal above rest), a constant."""
    row = int(one.row)
    if one.source == "=":
        return np.full(len(k), float(one.row))
    if one.source == "n":
        return np.arange(len(k)) % 256.0
    if one.source in "cd":
        values = drive.commands[k, row]
    else:
        values = drive.reports[k, row]
    if one.source in "pd":
        values = values + rest_frac
    if one.field == "ins.heading_rad":
        values = np.arctan2(np.sin(values), np.cos(values))
    return values / one.to_si


def write_folder(folder: Path, vehicle: Vehicle) -> None:
    """vehicle.dbc and vehicle.toml of a car."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "vehicle.dbc").write_text(dbc())
    (folder / "vehicle.toml").write_text(toml(vehicle))


def toml(vehicle: Vehicle) -> str:
    """vehicle.toml: the bus, which all cars share, and the data sheet, which is a few percent off."""
    absent = ", ".join(f'"{name}"' for name in ABSENT)
    lines = ['schema = "tunefree.vehicle/1"', 'name = "car"', 'dbc = ["vehicle.dbc"]', "bitrate = 500_000"]
    lines += [f"tick_ms = {TICK_MS}", f"absent = [{absent}]", ""]
    for name, (message, signals) in fields().items():
        lines += [f"[{name}]", f'message = "{message.name}"']
        names = ", ".join(f'"{one.name}"' for one in signals)
        lines.append(f"signal = {names if len(signals) == 1 else f'[{names}]'}")
        if signals[0].to_si != 1.0:
            lines.append(f"scale = {signals[0].to_si!r}")
        lines += [f"period_ms = {message.period_ms}", f"timeout_ms = {10 * message.period_ms}"]
        known = {one.name for one in message.signals}
        if name.startswith("command.") and "EN" in known:
            lines += ['enable = "EN"', 'counter = "COUNT"']
        lines.append("")
    return "\n".join(lines + _sheet(vehicle)) + "\n"


def _sheet(vehicle: Vehicle) -> list[str]:
    s, limits = vehicle.sheet, vehicle.limits
    lines = ["[ins_frame]", 'frame = "ENU"', 'origin = "local"', 'point = "rear_axle"']
    lines += [f"latency_s = {s['ins_latency_s']}", "", "[state]", "enabled = ["]
    lines += [
        f'    {{ message = "{name.upper()}_STATE", signal = "ENABLED", bywire = "{name}" }},'
        for name in ("throttle", "brake", "steer")
    ]
    lines += ["]", ""]
    for name in ("throttle", "brake", "steer"):
        lines += [
            f"[latency.{name}]",
            f"dead_time_s = {s[f'{name}_dead_s']}",
            f"rise_time_s = {s[f'{name}_rise_s']}",
            "",
        ]
    lines += ["[limits]", f"steer_rad = {limits.steer_rad}", f"steer_rate_radps = {limits.steer_rate_radps}"]
    lines += [f"throttle_frac = {limits.throttle_frac}", f"brake_frac = {limits.brake_frac}"]
    lines += [f"accel_mps2 = [{limits.accel_mps2[0]}, {limits.accel_mps2[1]}]"]
    lines += [f"lateral_accel_mps2 = {limits.lateral_mps2}", f"speed_mps = {limits.speed_mps}", "", "[nominal]"]
    nominal = ("mass_kg", "wheelbase_m", "front_axle_m", "yaw_inertia_kgm2", "steer_ratio", "wheel_radius_m", "track_m",
               "front_stiffness_n_per_rad", "rear_stiffness_n_per_rad", "rest_pedal_frac")  # fmt: skip
    return lines + [f"{name} = {s[name]}" for name in nominal]
