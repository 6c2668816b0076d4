"""How well does `calibrate` identify actuators that are not its own? Reference vehicles with drawn ones, from logs.

Only this measure opens the reference vehicle. Truth of a dead time is its delay line's length. Truth of a lag is the
time in which the channel's own answer to a small step, once it has begun, reaches 63 %, measured on its actuator Block
alone; a pedal presses slower than it lets go, so its truth is the mean of both ways. A fitted lag of order 2 is put in
the same words (63 % of its own small step).
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from msgspec.structs import replace as changed

from tools.measures._excitation import Excitation, excited
from tools.measures._in_process import InProcess
from tools.measures._ledger import FOLDER, ROOT, Ledger, code_hash, meaning
from tools.measures._summary import RESAMPLES, rounded
from tunefree_hil.base.kernel import Block
from tunefree_hil.base.records import GEAR_DRIVE, NAN, Command
from tunefree_hil.bench import load, parameters_of
from tunefree_hil.bench.load import Bench, model_of
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.bus.formats.rows import Row
from tunefree_hil.config.schema import ScenarioSpec
from tunefree_hil.episode.candump import write_candump
from tunefree_hil.learn.actuators import identify
from tunefree_hil.learn.actuators.samples import clip_to_stops, collect_samples
from tunefree_hil.learn.compiled_process import CompiledProcess
from tunefree_hil.learn.data_sheet import read_channel_sheet
from tunefree_hil.learn.drives.read import read_drives
from tunefree_hil.learn.drives.split import split_drives
from tunefree_hil.learn.estimate import ActuatorFit
from tunefree_hil.plant.reference_vehicle.actuators import own_actuators

VALUE = "largest relative error of dead time and lag, percent: 10 drawn vehicles, channels whose true value is >= 20 ms"
LEAST_TRUTH_S = 0.02
SMALL_S, FINE_S = 1.0, 1e-3  # length of a step response, and the reference vehicle's own step
CHANNELS = ("throttle", "brake", "steer")
SMALL = {"throttle": 0.02, "brake": 0.02, "steer": 0.02}
COUNTED = (
    "learn/actuators/identify.py",
    "learn/actuators/model.py",
    "learn/actuators/search.py",
    "learn/robust_least_squares.py",
    "learn/actuators/samples.py",
    "learn/drives/read.py",
    "learn/drives/decode.py",
    "learn/drives/smoothing.py",
    "learn/drives/split.py",
    "learn/data_sheet.py",
    "learn/estimate.py",
)
# [low, high] of what is drawn; shares of the published or chosen values of bench_configs/models/mkz_reference
BOXES = {
    "steer_dead_time_s": (0.04, 0.18),
    "steer_lag_s": (0.04, 0.13),
    "steer_motor_s": (0.008, 0.03),
    "steer_rate_radps": (5.0, 10.0),
    "throttle_dead_time_s": (0.01, 0.09),
    "throttle_press_s": (0.03, 0.12),
    "brake_dead_time_s": (0.01, 0.09),
    "brake_press_s": (0.03, 0.14),
}
RELEASES = (0.6, 1.4)  # of the press time


def measure(
    vehicles: int = 10,
    seconds: float = 240.0,
    bench: str = "bench_configs/mkz_complete.toml",
    seed: int = 1,
    folder: str = FOLDER,
) -> dict[str, Any]:
    """`vehicles` drawn, each driven for `seconds` on its own log. n: dead times and lags compared. Goes on when called
    again. low, high: 95 % of bootstraps over vehicles.
    """
    ledger = Ledger(Path(folder) / "actuators")
    loaded = load(ROOT / bench)
    rows: list[list[dict[str, Any]]] = []
    with CompiledProcess() as worker:
        for number in range(vehicles):
            depends = {"vehicle": number, "seed": seed, "seconds": seconds, "bench": bench, "code": _code()}
            known = ledger.find(depends)
            if known is None:
                known = ledger.keep(depends, _one(loaded, drawn(seed, number), seconds, number, worker))
                print(f"vehicle {number + 1} of {vehicles}: {_worst(known):.1f} %")
            rows.append(known)
    return _summary(rows)


def drawn(seed: int, number: int) -> dict[str, float]:
    """Actuator constants of one vehicle; dead times in whole steps of the reference vehicle."""
    chance = np.random.default_rng([seed, number])
    values = {name: float(chance.uniform(*box)) for name, box in BOXES.items()}
    for pedal in ("throttle", "brake"):
        values[f"{pedal}_release_s"] = values[f"{pedal}_press_s"] * float(chance.uniform(*RELEASES))
    return {name: round(value, 3) if name.endswith("dead_time_s") else value for name, value in values.items()}


def truth_of(values: Mapping[str, float], rest: float) -> dict[str, tuple[float, float]]:
    """(dead time, 63 % time of a small step behind it) by channel, from the Block of the actuators alone."""
    block = own_actuators({**values, "rest_pedal_frac": rest})
    found = {}
    for channel in CHANNELS:
        dead_s = float(values[f"{channel}_dead_time_s"])
        base = {"throttle": rest + 0.1, "brake": rest + 0.05, "steer": 0.0}[channel]
        ways = [_reached(block, channel, base, sign * SMALL[channel], rest) for sign in (1.0, -1.0)]
        found[channel] = (dead_s, float(np.mean(ways)) - dead_s)
    return found


def _reached(block: Block, channel: str, base: float, step: float, rest: float) -> float:
    """When a step of one channel has gone 63 % of its way, the command changing at 0."""
    index = CHANNELS.index(channel)

    def command(value: float) -> Command:
        values = [rest, rest, 0.0]
        values[index] = value
        return Command(values[0], values[1], values[2], GEAR_DRIVE, NAN, NAN)

    state = block.init(block.params, FINE_S)
    for _ in range(round(2.0 * SMALL_S / FINE_S)):
        state, out = block.step(block.params, state, command(base), FINE_S)
    before, goal = float(out[index]), (1.0 - math.exp(-1.0)) * step
    last = 0.0
    for k in range(1, round(SMALL_S / FINE_S)):
        state, out = block.step(block.params, state, command(base + step), FINE_S)
        gone = float(out[index]) - before
        if abs(gone) >= abs(goal):
            return (k - 1 + (goal - last) / (gone - last)) * FINE_S
        last = gone
    raise ValueError(f"{channel} does not answer a step within {SMALL_S} s")


def _one(
    bench: Bench, values: dict[str, float], seconds: float, number: int, worker: CompiledProcess
) -> list[dict[str, Any]]:
    """Rows of one vehicle: driven, logged, read, split, identified."""
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "vehicle.log"
        _drive(bench, values, seconds, number, log)
        drives = read_drives([log], Codec(bench.vehicle))
    split = split_drives(drives, seed=1)
    truths = truth_of(values, bench.vehicle.nominal.rest_pedal_frac)
    found = []
    for channel in CHANNELS:
        parts = clip_to_stops(collect_samples(split.training, channel), collect_samples(split.held_out, channel))
        sheet = read_channel_sheet(bench.vehicle, channel)
        one = worker.wait_for_result(identify.fit, *parts, sheet, True)
        found += _rows(channel, truths[channel], one)
    return found


def _rows(channel: str, truth: tuple[float, float], one: ActuatorFit) -> list[dict[str, Any]]:
    dead = {"what": "dead time", "truth_s": truth[0], "found_s": one.dead_time_s.value}
    dead |= {"low_s": one.dead_time_s.low, "high_s": one.dead_time_s.high}
    lag = {"what": "lag", "truth_s": truth[1], "found_s": one.lag_63_s()}
    lag |= {"low_s": one.lag_s.low, "high_s": one.lag_s.high} if one.order == 1 else {"low_s": None, "high_s": None}
    more = {"channel": channel, "order": one.order, "error": one.error, "known": one.dead_time_s.known}
    return [{**more, **row} for row in (dead, lag)]


def _drive(bench: Bench, values: dict[str, float], seconds: float, number: int, log: Path) -> None:
    """A drive of the reference vehicle with these actuators, its frames as a candump log."""
    scenario = level_road(bench, seconds)
    model = model_of(bench, bench.spec.verify_model)
    plant = changed(model.plant, params={**model.plant.params, **values})
    alone = replace(bench, scenarios={scenario.name: scenario}, courses={})
    process = InProcess(alone, changed(model, plant=plant))  # type: ignore[arg-type]
    excited(process, Excitation(bench.vehicle, number))
    driven = process.drive(scenario, parameters_of(bench))
    if driven.error:
        raise RuntimeError(f"the drive ended with {driven.error}: {driven.said}")
    write_candump(log, [Row(f.time_s, f.channel, f.can_id, f.data, f.flags) for f in driven.frames])


def level_road(bench: Bench, seconds: float) -> ScenarioSpec:
    """A straight, level road, as long as it must be; what is driven on it the excitation says."""
    scenario = next(iter(bench.scenarios.values()))
    profile = type(scenario.speed)
    return changed(
        scenario,
        name="excitation",
        start=changed(scenario.start, lateral_m=0.0, heading_rad=0.0, speed_mps=5.0),
        speed=profile(t_s=[0.0, seconds], value=[5.0, 5.0]),
        curvature=profile(t_s=[0.0, seconds], value=[0.0, 0.0]),
        grade=None,
        friction=None,
        hash="ac" * 32,
    )


def _relative(row: Mapping[str, Any]) -> float:
    return 100.0 * abs(row["found_s"] - row["truth_s"]) / row["truth_s"]


def _counted(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [row for row in rows if row["truth_s"] >= LEAST_TRUTH_S]


def _worst(rows: list[dict[str, Any]]) -> float:
    return max((_relative(row) for row in _counted(rows)), default=0.0)


def _summary(rows: list[list[dict[str, Any]]]) -> dict[str, Any]:
    worst = np.array([_worst(some) for some in rows])
    chance = np.random.default_rng(1)
    maxima = np.max(chance.choice(worst, (RESAMPLES, len(worst))), axis=1)
    low, high = (float(edge) for edge in np.percentile(maxima, [2.5, 97.5]))
    counted = [row | {"percent": _relative(row)} for some in rows for row in _counted(some)]
    kinds = sorted({(row["channel"], row["what"]) for row in counted})
    median = {
        f"{channel} {what}": float(
            np.median([row["percent"] for row in counted if (row["channel"], row["what"]) == (channel, what)])
        )
        for channel, what in kinds
    }
    inside = [row["low_s"] <= row["truth_s"] <= row["high_s"] for row in counted if row["low_s"] is not None]
    detail = {"median_percent": median, "intervals_hold_truth": float(np.mean(inside)), "rows": counted}
    detail["left_out_below_20_ms"] = sum(len(some) for some in rows) - len(counted)
    return {
        "value": float(worst.max()),
        "unit": "%",
        "n": len(counted),
        "low": low,
        "high": high,
        "detail": rounded(detail),
    }


def _code() -> str:
    """The code that the numbers depend on."""
    from hashlib import sha256

    texts = [meaning((ROOT / "tunefree_hil" / name).read_text(encoding="utf-8")) for name in COUNTED]
    texts += [meaning((ROOT / "tools" / "measures" / name).read_text(encoding="utf-8")) for name in ("_excitation.py",)]
    return sha256("".join([code_hash(), *texts]).encode()).hexdigest()
