"""Brings a CSV of a test drive in: a candump log, and the vehicle folder (its DBC invented) that it is read with."""

from __future__ import annotations

import hashlib
import json
import math
import os
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tunefree_hil import __version__
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.base.records import GROUPS
from tunefree_hil.bus.dbc.synthetic_dbc import ENABLED, HIGHEST, STEP, dbc_text
from tunefree_hil.bus.formats.rows import FD, Row
from tunefree_hil.config.dump import to_toml
from tunefree_hil.config.load import load_import, load_vehicle
from tunefree_hil.episode.candump import write_candump
from tunefree_hil.episode.csv_drive import CsvDrive, read_csv_drive
from tunefree_hil.episode.plausible import Finding, check_units
from tunefree_hil.jobs.command_text import pasted
from tunefree_hil.jobs.log.vehicle import vehicle_table

if TYPE_CHECKING:
    from tunefree_hil.bus.dbc.codec import Codec
    from tunefree_hil.bus.dbc.message_map import MessageMap
    from tunefree_hil.config.import_schema import ImportSpec

CHANNEL = "can0"
LOG, RECORD = "drive.log", "import.json"
MOST_GAPS_SAID = 20
HEAD = """\
# Invented by `tunefree-hil log import` (version {version}): these data never were on a CAN bus, and vehicle.dbc
# describes nobody's network. Made anew by each import; do not edit by hand.
# Made of: {csv}
# Source of the data: {source}
"""


def import_csv(path: Path, mapping: Path, out: Path) -> Iterator[Event]:
    """Write `out`/drive.log, vehicle.toml, vehicle.dbc and import.json. Gaps and empty cells are named, never filled.

    Raises InputError for rows out of order, and for columns that contradict each other in their units.
    """
    spec = load_import(mapping)
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError("it is there already", code="exists", file=str(out), hint="choose another folder, or move it")
    drive = read_csv_drive(path, spec)
    duration_s = float(drive.time_s[-1] - drive.time_s[0])
    yield Event("note", f"{path}: {len(drive.time_s)} rows, {duration_s:.2f} s, {len(drive.columns)} record fields")
    yield from _say_gaps(drive)
    car = spec.nominal
    findings = check_units(drive, car.wheelbase_m, car.steer_ratio, car.wheel_radius_m)
    for finding in findings:
        if finding.holds is not False or finding.check in spec.accept:
            yield Event("note" if finding.holds else "warning", f"{finding.check}: {finding.words}")
    _refuse_swapped(findings, spec, path)
    _refuse_beyond(drive, path)
    record = _record(path, mapping, spec, drive, findings)
    frames, error = _write(out, path, spec, drive, record)
    sentence = f"{frames} frames of {duration_s:.2f} s in {out / LOG}, read with the invented DBC beside it"
    following = [pasted("log check", out / LOG), pasted("doctor", vehicle=out)]
    data = {**record, "frames": frames, "largest_error": error, "log": str(out / LOG), "vehicle": str(out)}
    yield Event("result", "", {**data, "sentence": sentence, "next": following})


def _say_gaps(drive: CsvDrive) -> Iterator[Event]:
    for gap in drive.gaps[:MOST_GAPS_SAID]:
        what = f"{gap.what} has no value" if gap.what else "no row"
        length_s = gap.end_s - gap.begin_s
        yield Event(
            "warning", f"gap: {what} from {gap.begin_s:.3f} to {gap.end_s:.3f} s ({length_s:.3f} s); not filled"
        )
    if len(drive.gaps) > MOST_GAPS_SAID:
        yield Event("warning", f"gap: {len(drive.gaps) - MOST_GAPS_SAID} more, all in {RECORD}")
    for name in drive.columns:
        if drive.held_out(name):
            yield Event("warning", f"{name}: {drive.held_out(name)} cells hold no value; their frames are left out")


def _refuse_swapped(findings: Sequence[Finding], spec: ImportSpec, path: Path) -> None:
    wrong = [one for one in findings if one.holds is False and one.check not in spec.accept]
    if wrong:
        raise InputError(
            "the units cannot be right:\n" + "\n".join(f"  {one.words}" for one in wrong),
            code="swapped_units",
            file=str(path),
            key=wrong[0].check,
            hint=f"mend unit, scale or field in {spec.path}; where the drive really is like that, say why: "
            f'accept = {{ {wrong[0].check} = "reason" }}',
        )


def _refuse_beyond(drive: CsvDrive, path: Path) -> None:
    for name, column in drive.columns.items():
        some = column.values[column.sent]
        if some.size and float(np.abs(some).max()) > HIGHEST:
            raise InputError(
                f"{name} reaches {np.abs(some).max():g}, more than the {HIGHEST:g} that a frame holds here",
                code="beyond",
                file=str(path),
                key=column.spec.column,
                hint="give it an offset that brings it near 0",
            )


def _record(
    path: Path, mapping: Path, spec: ImportSpec, drive: CsvDrive, findings: Sequence[Finding]
) -> dict[str, Any]:
    return {
        "schema": "tunefree.imported/1",
        "version": __version__,
        "csv": path.name,
        "csv_hash": hashlib.sha256(path.read_bytes()).hexdigest(),
        "mapping": mapping.name,
        "mapping_hash": spec.hash,
        "source": spec.source,
        "rows": len(drive.time_s),
        "step_s": drive.step_s if math.isfinite(drive.step_s) else None,
        "quantisation": STEP,
        "values": {name: int(column.sent.sum()) for name, column in drive.columns.items()},
        "held_out": {name: drive.held_out(name) for name in drive.columns},
        "gaps": [gap._asdict() for gap in drive.gaps],
        "plausibility": [finding._asdict() for finding in findings],
        "accepted": spec.accept,
    }


def _write(out: Path, path: Path, spec: ImportSpec, drive: CsvDrive, record: dict[str, Any]) -> tuple[int, float]:
    """(frames, largest error of quantisation). The folder gets its name when all is in it."""
    part = out.with_name(f"part-{os.getpid()}-{out.name}")
    part.mkdir(parents=True)
    try:
        units = {
            name: f"column '{one.spec.column}' in {one.spec.unit}"
            + (f" ({one.spec.assumed})" if one.spec.assumed else "")
            for name, one in drive.columns.items()
        }
        obeyed = "" if spec.enabled is None else f"column '{spec.enabled.column}' is {spec.enabled.active:g}"
        (part / "vehicle.dbc").write_text(dbc_text(list(drive.columns), spec.source, units, obeyed), encoding="utf-8")
        head = HEAD.format(version=__version__, csv=path.name, source=" ".join(spec.source.split()))
        (part / "vehicle.toml").write_text(head + to_toml(vehicle_table(spec, drive)), encoding="utf-8")
        rows, error = frames_of(drive, part)
        write_candump(part / LOG, rows)
        whole = {**record, "frames": len(rows), "largest_error": error}
        (part / RECORD).write_text(json.dumps(whole, indent=1) + "\n", encoding="utf-8")
        if out.is_dir():
            out.rmdir()  # it is empty
        os.replace(part, out)
        return len(rows), error
    finally:
        if part.is_dir():
            shutil.rmtree(part)


def _states(drive: CsvDrive, codec: Codec, message: MessageMap) -> Iterator[tuple[int, Row]]:
    """(row of the CSV, frame) wherever a cell says whether the vehicle obeyed."""
    enabled = np.zeros(0) if drive.enabled is None else drive.enabled
    for i in np.flatnonzero(np.isfinite(enabled)).tolist():
        data = codec.encode(message, {}, {ENABLED: float(enabled[i])})
        yield i, Row(float(drive.time_s[i]), CHANNEL, message.key, data, 0)


def frames_of(drive: CsvDrive, folder: Path) -> tuple[list[Row], float]:
    """(the frames by time, largest difference between a value and what its frame says), by the folder's own codec."""
    from tunefree_hil.bus.dbc.codec import Codec

    codec = Codec(load_vehicle(folder))
    found: list[tuple[int, int, Row]] = []
    error = 0.0
    for message in codec.by_name.values():
        if not message.fields:  # whether the vehicle obeyed
            found += [(i, message.key, row) for i, row in _states(drive, codec, message)]
            continue
        names = [f"{field.group}.{field.name}" for field in message.fields]
        columns = [drive.columns[name] for name in names]
        sent = np.logical_and.reduce([column.sent for column in columns])
        for i in np.flatnonzero(sent):
            values = {
                field.name: float(column.values[i]) for field, column in zip(message.fields, columns, strict=True)
            }
            group = message.fields[0].group
            data = codec.encode(message, {group: GROUPS[group](**values)}, {})
            flags = FD if message.fd else 0
            found.append((int(i), message.key, Row(float(drive.time_s[i]), CHANNEL, message.key, data, flags)))
            back = {index: value for _, index, value in codec.values(message, codec.decode(message, data))}
            for field in message.fields:
                off = back[field.index] - values[field.name]
                turned = math.remainder(off, 2.0 * math.pi) if field.name == "heading_rad" else off
                error = max(error, abs(turned))
    found.sort(key=lambda one: one[:2])
    return [row for _, _, row in found], error
