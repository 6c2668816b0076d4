"""Converts a log into another format, says what that cannot hold, and reads the result back to prove it."""

from __future__ import annotations

import math
import os
import shutil
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path

from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bus.formats.find import CANDUMP, format_for, load_format
from tunefree_hil.bus.formats.rows import TICK_S, Format, Held, Loss, Row, change
from tunefree_hil.episode.candump import read_rows, write_candump
from tunefree_hil.jobs.log_files import load_rows

EXACT_S = 2e-9  # and what a double holds of an epoch time: below that a stamp is kept


def convert(source: Path, target: Path, *, channels: Sequence[str] = (), to: str = "") -> Iterator[Event]:
    """Write `target` in the format of its suffix (or `to`); a warning for each thing that is lost.

    channels: only these. The result's data: frames read and written, losses. Raises InputError where there is nothing
    to write, or `target` is there already; BenchError when what was written does not read back as it should.
    """
    name = format_for(target, to)
    if target.exists():
        raise InputError("it is there already", code="exists", file=str(target), hint="choose another name, or move it")
    form = _format(name)
    rows, source_name = load_rows(source)
    chosen, left = _choose(rows, channels, source)
    yield Event("note", f"{source}: {source_name}, {len(rows)} frames on {', '.join(_names(rows))}")
    held = form.hold(chosen)
    if not held.rows:
        raise InputError(
            f"{name} can hold none of the {len(chosen)} frames: {'; '.join(map(str, held.losses))}",
            code="nothing_left",
            file=str(source),
            hint="choose another format: candump, blf and csv hold every frame",
        )
    losses = [*held.losses, *_write(form, target, held.rows)]
    for loss in losses:
        yield Event("warning", f"{name}: {loss}")
    data = {
        "format": name,
        "read": len(rows),
        "not_chosen": left,
        "written": len(held.rows),
        "losses": [loss._asdict() for loss in losses],
        "out": str(target),
    }
    lost = f"; {len(losses)} kinds of loss, said above" if len(losses) > 1 else f"; {losses[0]}" if losses else ""
    aside = f" ({left} on other channels)" if left else ""
    yield Event("result", "", {**data, "sentence": f"{len(held.rows)} of {len(rows)} frames{aside} in {target}{lost}"})


def _format(name: str) -> Format:
    if name != CANDUMP:
        return load_format(name)
    return Format(CANDUMP, read_rows, write_candump, _hold_candump)


def _hold_candump(rows: Sequence[Row]) -> Held:
    """Everything is kept; a channel's name must be one word, and an id of 11 bits no more than that."""
    return change(
        rows,
        lambda row: row._replace(channel="_".join(row.channel.split()) or "can0"),
        "the channel's name is changed to one word",
    )


def _names(rows: Sequence[Row]) -> list[str]:
    return sorted({row.channel for row in rows})


def _choose(rows: Sequence[Row], channels: Sequence[str], source: Path) -> tuple[list[Row], int]:
    """(rows of the channels, how many were left out)."""
    there = _names(rows)
    for channel in channels:
        if channel not in there:
            raise InputError(
                f"no channel {channel!r} in it",
                code="no_channel",
                file=str(source),
                key="--channel",
                hint=f"there are {', '.join(there)}",
            )
    chosen = [row for row in rows if row.channel in channels] if channels else list(rows)
    return chosen, len(rows) - len(chosen)


def _write(form: Format, target: Path, rows: list[Row]) -> list[Loss]:
    """Write beside the target, read back, and only then give the file its name; what reading back shows."""
    target.parent.mkdir(parents=True, exist_ok=True)
    part = target.with_name(f"part-{os.getpid()}-{target.name}")
    try:
        form.write(part, rows)
        found = form.read(part)
        _refuse_different(rows, found, target)
        os.replace(part, target)
        return _changed(rows, found)
    finally:
        if part.is_dir():
            shutil.rmtree(part)
        part.unlink(missing_ok=True)


def _refuse_different(wanted: Sequence[Row], found: Sequence[Row], target: Path) -> None:
    """Raise BenchError unless the same frames came back, each within a microsecond of its time."""
    left, right = _by_content(wanted), _by_content(found)
    for content in left.keys() | right.keys():
        a, b = left.get(content, []), right.get(content, [])
        if len(a) != len(b) or any(abs(x - y) >= TICK_S for x, y in zip(a, b, strict=True)):
            raise BenchError(
                f"what was written does not read back: {len(a)} frames 0x{content[1] & 0x1FFFFFFF:X} on {content[0]} "
                f"went in, {len(b)} came back, or their stamps moved",
                code="conversion",
                file=str(target),
                hint="nothing was left there; report this log",
            )


def _changed(wanted: Sequence[Row], found: Sequence[Row]) -> list[Loss]:
    """Frames that changed places with others of the same time, and stamps that were rounded."""
    losses = []
    moved = sum(a[1:] != b[1:] for a, b in zip(wanted, found, strict=True))
    if moved:
        losses.append(Loss(moved, "comes in another place, for the format keeps frames in the order of time only"))
    left, right = _by_content(wanted), _by_content(found)
    pairs = [pair for content, times in left.items() for pair in zip(times, right[content], strict=True)]
    rounded = [abs(a - b) for a, b in pairs if abs(a - b) > max(EXACT_S, 2.0 * math.ulp(a))]
    if rounded:
        losses.append(Loss(len(rounded), f"the stamp is rounded, by at most {1e6 * max(rounded):.3f} us"))
    return losses


def _by_content(rows: Sequence[Row]) -> dict[tuple[str, int, bytes, int, int], list[float]]:
    """The sorted stamps of each kind of frame."""
    found: dict[tuple[str, int, bytes, int, int], list[float]] = defaultdict(list)
    for row in rows:
        found[row[1:]].append(row.time_s)
    return {content: sorted(times) for content, times in found.items()}
