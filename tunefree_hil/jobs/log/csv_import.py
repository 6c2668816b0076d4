"""Import a CSV of a test drive as a candump log, with a vehicle folder and a synthetic DBC to read it."""

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
from tunefree_hil.jobs.command_text import shell_command
from tunefree_hil.jobs.log.options import LogImportOptions
from tunefree_hil.jobs.log.vehicle import vehicle_table

if TYPE_CHECKING:
    from tunefree_hil.bus.dbc.codec import Codec
    from tunefree_hil.bus.dbc.message_map import MessageMap
    from tunefree_hil.config.import_schema import ImportSpec

CHANNEL = "can0"
LOG, RECORD = "drive.log", "import.json"
MAX_GAPS_LISTED = 20
HEAD = """\
# Invented by `tunefree-hil log import` (version {version}): these data never were on a CAN bus, and vehicle.dbc
# describes nobody's network. Made anew by each import; do not edit by hand.
# Made of: {csv}
# Source of the data: {source}
"""


def import_csv(options: LogImportOptions) -> Iterator[Event]:
    """Write drive.log, vehicle.toml, vehicle.dbc and import.json. Gaps and empty cells are reported, not filled.

    Raises InputError for rows out of order, and for columns with contradictory units.
    """
    path, mapping, out = options
    spec = load_import(mapping)
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError("already exists", code="exists", file=str(out), hint="choose another folder, or move it")
    drive = read_csv_drive(path, spec)
    duration_s = float(drive.time_s[-1] - drive.time_s[0])
    yield Event("note", f"{path}: {len(drive.time_s)} rows, {duration_s:.2f} s, {len(drive.columns)} record fields")
    yield from _gap_warnings(drive)
    car = spec.nominal
    findings = check_units(drive, car.wheelbase_m, car.steer_ratio, car.wheel_radius_m)
    for finding in findings:
        if finding.holds is not False or finding.check in spec.accept:
            yield Event("note" if finding.holds else "warning", f"{finding.check}: {finding.words}")
    _require_plausible_units(findings, spec, path)
    _require_encodable(drive, path)
    record = _record(path, mapping, spec, drive, findings)
    frames, error = _write(out, path, spec, drive, record)
    sentence = f"{frames} frames of {duration_s:.2f} s in {out / LOG}, to be read with the synthetic DBC beside it"
    following = [shell_command("log check", out / LOG), shell_command("doctor", vehicle=out)]
    data = {**record, "frames": frames, "largest_error": error, "log": str(out / LOG), "vehicle": str(out)}
    yield Event("result", "", {**data, "sentence": sentence, "next": following})


def _gap_warnings(drive: CsvDrive) -> Iterator[Event]:
    for gap in drive.gaps[:MAX_GAPS_LISTED]:
        subject = f"{gap.what} has no value" if gap.what else "no row"
        length_s = gap.end_s - gap.begin_s
        yield Event(
            "warning", f"gap: {subject} from {gap.begin_s:.3f} to {gap.end_s:.3f} s ({length_s:.3f} s); not filled"
        )
    if len(drive.gaps) > MAX_GAPS_LISTED:
        yield Event("warning", f"gap: {len(drive.gaps) - MAX_GAPS_LISTED} more, all in {RECORD}")
    for name in drive.columns:
        if drive.held_out(name):
            yield Event("warning", f"{name}: {drive.held_out(name)} cells have no value; their frames are left out")


def _require_plausible_units(findings: Sequence[Finding], spec: ImportSpec, path: Path) -> None:
    wrong = [finding for finding in findings if finding.holds is False and finding.check not in spec.accept]
    if wrong:
        raise InputError(
            "the units cannot be right:\n" + "\n".join(f"  {one.words}" for one in wrong),
            code="swapped_units",
            file=str(path),
            key=wrong[0].check,
            hint=f"correct unit, scale or field in {spec.path}; where the values are right, give the reason: "
            f'accept = {{ {wrong[0].check} = "reason" }}',
        )


def _require_encodable(drive: CsvDrive, path: Path) -> None:
    for name, column in drive.columns.items():
        values = column.values[column.sent]
        if values.size and float(np.abs(values).max()) > HIGHEST:
            message = f"{name} reaches {np.abs(values).max():g}, above the limit {HIGHEST:g} of the synthetic DBC"
            hint = "add an offset that brings the values near 0"
            raise InputError(message, code="beyond", file=str(path), key=column.spec.column, hint=hint)


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
    """Write the folder, renamed when complete. Returns the number of frames, and the largest quantisation error."""
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
        rows, error = encode_frames(drive, part)
        write_candump(part / LOG, rows)
        whole = {**record, "frames": len(rows), "largest_error": error}
        (part / RECORD).write_text(json.dumps(whole, indent=1) + "\n", encoding="utf-8")
        if out.is_dir():
            out.rmdir()  # checked to be empty
        os.replace(part, out)
        return len(rows), error
    finally:
        if part.is_dir():
            shutil.rmtree(part)


def _state_frames(drive: CsvDrive, codec: Codec, message: MessageMap) -> Iterator[tuple[int, Row]]:
    """CSV row and frame of each cell with the by-wire state."""
    enabled = np.zeros(0) if drive.enabled is None else drive.enabled
    for i in np.flatnonzero(np.isfinite(enabled)).tolist():
        data = codec.encode(message, {}, {ENABLED: float(enabled[i])})
        yield i, Row(float(drive.time_s[i]), CHANNEL, message.key, data, 0)


def encode_frames(drive: CsvDrive, folder: Path) -> tuple[list[Row], float]:
    """Encode a drive with the folder's codec. Returns the frames by time, and the largest quantisation error."""
    from tunefree_hil.bus.dbc.codec import Codec

    codec = Codec(load_vehicle(folder))
    frames: list[tuple[int, int, Row]] = []
    error = 0.0
    for message in codec.by_name.values():
        if not message.fields:  # the by-wire state
            frames += [(i, message.key, row) for i, row in _state_frames(drive, codec, message)]
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
            frames.append((int(i), message.key, Row(float(drive.time_s[i]), CHANNEL, message.key, data, flags)))
            back = {index: value for _, index, value in codec.values(message, codec.decode(message, data))}
            for field in message.fields:
                off = back[field.index] - values[field.name]
                turned = math.remainder(off, 2.0 * math.pi) if field.name == "heading_rad" else off
                error = max(error, abs(turned))
    frames.sort(key=lambda item: item[:2])
    return [row for _, _, row in frames], error
