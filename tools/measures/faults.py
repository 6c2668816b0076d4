"""Every kind of bus fault x every message of a vehicle x three moments: is it answered within 250 ms?

An answer is a status (E2E, arrival, rate), an error code or a named event; the same drive without a fault gives none.
A corrupt frame needs a CRC to be seen, a duplicate or stale one a counter; where the message has none, the row is
listed apart as "not detectable by protocol", whatever else may have noticed it. A fault lasts 250 ms;
`frames=1` makes faults that meet a single frame of a message.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from tools.measures._in_process import Drive, InProcess
from tunefree_hil.bench import Bench, load, parameters_of
from tunefree_hil.bus import bench_channel as bc
from tunefree_hil.bus.dbc.message_map import MessageMap
from tunefree_hil.config.fault_check import COUNTER_KINDS, CRC_KINDS, FAULT_KINDS, FRAME_KINDS, PEERS
from tunefree_hil.config.load import load_bench
from tunefree_hil.config.schema import FaultSpec, ScenarioSpec

ROOT = Path(__file__).resolve().parents[2]

VALUE = "bus faults without status, error code or named event within 250 ms, among those the protocol can see (0)"
MOMENTS = (40, 163, 297)  # ticks
LIMIT_TICKS = 25
VALUES = {"delay": 5.0, "corrupt": 1.0, "crc_value": 90.0, "crc_offset": 1.0, "counter_value": 0.0,
          "counter_offset": 5.0, "burst": 5.0}  # fmt: skip
DRIVERS = {"throttle": 0.5, "brake": 0.4, "steer": 10.0, "gear": 0.0}  # duty, Nm
NOT_DETECTABLE, SILENT = "not detectable by protocol", "silent"


class Row(NamedTuple):
    """One fault. after_ticks: to the first answer, -1 where there was none."""

    vehicle: str
    kind: str
    where: str  # message, channel of the driver, or peer
    tick: int
    answer: str
    after_ticks: int


def measure(
    benches: str = "", every: int = 1, seed: int = 1, table: str = "", rows: int = 0, frames: int = 0
) -> dict[str, Any]:
    """benches: bench files, by default one of each vehicle. every: only each such case.

    table: a file for the whole table. rows: how many of its rows the detail lists. frames: how many frames of its
    message a fault meets, 0 for as many as come in 250 ms.
    """
    chosen = [load(name) for name in benches.split(",")] if benches else one_of_each_vehicle()
    found = [row for bench in chosen for row in rows_of(bench, every, seed, frames)]
    detectable = [row for row in found if row.answer != NOT_DETECTABLE]
    silent = [row for row in detectable if row.answer == SILENT]
    if table:
        Path(table).write_text(as_text(found))
    detail = {
        "rows": len(found),
        "detectable": len(detectable),
        "not_detectable_by_protocol": len(found) - len(detectable),
        "silent": [row._asdict() for row in silent],
        "worst_ms": 10 * max((row.after_ticks for row in detectable), default=0),
        "by_vehicle_and_kind": by_kind(found),
        "table": [row._asdict() for row in found[:rows]],
    }
    return {"value": len(silent), "unit": "silent faults", "n": len(detectable), "low": None, "high": None,
            "detail": detail}  # fmt: skip


def one_of_each_vehicle() -> list[Bench]:
    """The last bench file of each vehicle, by name; those that start somebody's own controller do not count."""
    specs = [load_bench(path) for path in sorted((ROOT / "bench_configs").glob("*.toml"))]
    found = {spec.vehicle: spec.path for spec in specs if not spec.controller.command}
    return [load(path) for path in found.values()]


def rows_of(bench: Bench, every: int = 1, seed: int = 1, frames: int = 0) -> list[Row]:
    """The table of one bench file's vehicle, in its first scenario that is long enough. frames: see `measure`."""
    rig, values = InProcess(bench), parameters_of(bench)
    scenario = long_enough(bench)
    clean = rig.drive(scenario, values, keep=False, until=MOMENTS[-1] + LIMIT_TICKS + 2)
    first = answer(clean, 0, 1 << 31)
    if first is not None:
        raise AssertionError(f"{bench.vehicle.name} without a fault: {first[0]} at tick {first[1]}")
    found = []
    for fault in list(cases(bench, seed, frames))[::every]:
        rig.script([fault])
        drive = rig.drive(scenario, values, keep=False, until=fault.from_tick + LIMIT_TICKS + 2)
        message = bench.codec.by_name.get(fault.message)
        said = answer(drive, fault.from_tick, LIMIT_TICKS)
        words, after = said if said is not None else (SILENT, -1)
        if message is not None and not is_detectable(fault.kind, message):
            words = NOT_DETECTABLE
        where = fault.message or fault.channel
        found.append(Row(bench.vehicle.name, fault.kind, where, fault.from_tick, words, after))
    return found


def long_enough(bench: Bench) -> ScenarioSpec:
    """The first scenario that is not over before the last fault could be answered."""
    needed = MOMENTS[-1] + LIMIT_TICKS + 2
    for scenario in bench.scenarios.values():
        if bench.course(scenario).ticks >= needed:
            return scenario
    raise ValueError(f"{bench.file}: no scenario of at least {needed} ticks")


def cases(bench: Bench, seed: int, frames: int = 0) -> Iterator[FaultSpec]:
    """Every kind that a message can have, at each moment; every peer and every hand too where `frames` is 0."""

    def fault(kind: str, moment: int, *, message: str = "", channel: str = "", value: float = 0.0) -> FaultSpec:
        period = bench.codec.by_name[message].period_ticks if message else 1
        end = moment + (frames * period or LIMIT_TICKS)
        return FaultSpec(
            kind=kind, message=message, channel=channel, value=value, from_tick=moment, to_tick=end, seed=seed
        )

    for moment in MOMENTS:
        for message in (*bench.codec.commands, *bench.codec.telemetry):
            for kind in kinds_of(message):
                yield fault(kind, moment, message=message.name, value=VALUES.get(kind, 0.0))
        if frames:
            continue
        for peer in PEERS:
            yield fault("peer_stop", moment, channel=peer)
        for channel, value in DRIVERS.items():
            yield fault("driver_override", moment, channel=channel, value=value)


def kinds_of(message: MessageMap) -> list[str]:
    """Faults of a message's frames; without CRC or counter there is none to disturb."""
    without = [*(CRC_KINDS if message.e2e is None else ()), *(COUNTER_KINDS if not message.counter else ())]
    return [kind for kind in FRAME_KINDS if kind not in without]


def is_detectable(kind: str, message: MessageMap) -> bool:
    """Whether the message carries what such a frame could be seen by."""
    if kind == "corrupt":
        return message.e2e is not None
    return bool(message.counter) if kind in ("duplicate", "stale") else True


def answer(drive: Drive, tick: int, limit: int) -> tuple[str, int] | None:
    """(words, ticks after `tick`) of the first answer of a drive from `tick` on, None where none came in time."""
    found = []
    for word in drive.words:
        if isinstance(word, bc.Status) and word.role == bc.Role.CONTROLLER and word.error_code:
            found.append((word.tick, bc.ErrorCode(word.error_code).name.lower()))
        elif isinstance(word, bc.Fault) and word.index == bc.NOT_SCRIPTED:
            found.append((word.tick, f"watchdog {word.code}"))
    for line in drive.said:
        role, _, rest = line.partition(": tick ")
        number, _, words = rest.partition(": ")
        if number.isdigit():
            found.append((int(number), f"{role}: {words}"))
    inside = [(at, words) for at, words in found if tick <= at <= tick + limit]
    if not inside:
        return None
    at, words = min(inside, key=lambda one: one[0])
    return words, at - tick


def by_kind(rows: Sequence[Row]) -> dict[str, dict[str, str]]:
    """{vehicle: {kind: 'answered / detectable, worst'}}."""
    found: dict[str, dict[str, str]] = {}
    for vehicle in dict.fromkeys(row.vehicle for row in rows):
        for kind in FAULT_KINDS:
            of_kind = [row for row in rows if (row.vehicle, row.kind) == (vehicle, kind)]
            seen = [row for row in of_kind if row.answer != NOT_DETECTABLE]
            counts = Counter(row.answer == SILENT for row in seen)
            if of_kind:
                worst = 10 * max((row.after_ticks for row in seen), default=0)
                apart = f", {len(of_kind) - len(seen)} not detectable" if len(seen) < len(of_kind) else ""
                found.setdefault(vehicle, {})[kind] = f"{counts[False]} of {len(seen)}, {worst} ms{apart}"
    return found


def as_text(rows: Sequence[Row]) -> str:
    """The whole table, a line a row."""
    lines = [f"{'vehicle':12} {'kind':16} {'where':22} {'tick':>5} {'after ms':>8}  first answer"]
    for row in rows:
        after = str(10 * row.after_ticks) if row.after_ticks >= 0 else "-"
        lines.append(f"{row.vehicle:12} {row.kind:16} {row.where:22} {row.tick:5} {after:>8}  {row.answer}")
    return "\n".join(lines) + "\n"
