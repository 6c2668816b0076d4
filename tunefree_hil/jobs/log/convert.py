"""Converts a log into another format, says what that cannot hold, and reads the result back to prove it.

The source is read three times, frame by frame: for what a writer must know before the first, to be written, and beside
the result. So a log may be larger than the memory.
"""

from __future__ import annotations

import os
import shutil
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bus.formats.compare import Proof
from tunefree_hil.bus.formats.find import CANDUMP, format_for, load_format
from tunefree_hil.bus.formats.rows import Format, Loss, Lost, Row, Survey, change, survey
from tunefree_hil.episode.candump import read_rows, write_candump
from tunefree_hil.jobs.log.files import Log, open_log


def convert(source: Path, target: Path, *, channels: Sequence[str] = (), to: str = "") -> Iterator[Event]:
    """Write `target` in the format of its suffix (or `to`); a warning for each thing that is lost.

    channels: only these. The result's data: frames read and written, losses. Raises InputError where there is nothing
    to write, or `target` is there already; BenchError when what was written does not read back as it should.
    """
    name = format_for(target, to)
    if target.exists():
        raise InputError("it is there already", code="exists", file=str(target), hint="choose another name, or move it")
    form = _format(name)
    log = open_log(source)
    whole = survey(log.rows())
    yield Event("note", f"{source}: {log.format}, {whole.frames} frames on {', '.join(sorted(whole.channels))}")
    seen = _choose(log, whole, channels)
    written, losses = _write(form, target, log, seen)
    for loss in losses:
        yield Event("warning", f"{name}: {loss}")
    left = whole.frames - seen.frames
    data = {
        "format": name,
        "read": whole.frames,
        "not_chosen": left,
        "written": written,
        "losses": [loss._asdict() for loss in losses],
        "out": str(target),
    }
    lost = f"; {len(losses)} kinds of loss, said above" if len(losses) > 1 else f"; {losses[0]}" if losses else ""
    aside = f" ({left} on other channels)" if left else ""
    yield Event("result", "", {**data, "sentence": f"{written} of {whole.frames} frames{aside} in {target}{lost}"})


def _format(name: str) -> Format:
    if name != CANDUMP:
        return load_format(name)
    return Format(CANDUMP, read_rows, write_candump, _hold_candump)


def _hold_candump(rows: Iterable[Row], seen: Survey, lost: Lost) -> Iterable[Row]:
    """Everything is kept; a channel's name must be one word."""
    words = {name: "_".join(name.split()) or "can0" for name in seen.channels}
    if all(name == word for name, word in words.items()):
        return rows
    what = "the channel's name is changed to one word"
    return change(rows, lambda row: row._replace(channel=words[row.channel]), what, lost)


def _choose(log: Log, whole: Survey, channels: Sequence[str]) -> Survey:
    """What is known of the rows of the channels."""
    for channel in channels:
        if channel not in whole.channels:
            raise InputError(
                f"no channel {channel!r} in it",
                code="no_channel",
                file=str(log.path),
                key="--channel",
                hint=f"there are {', '.join(sorted(whole.channels))}",
            )
    if not channels or whole.channels.keys() <= set(channels):
        return whole
    return survey(row for row in log.rows() if row.channel in channels)


def _write(form: Format, target: Path, log: Log, seen: Survey) -> tuple[int, list[Loss]]:
    """Write beside the target, read back, and only then give the file its name. (frames, all losses)."""

    def held(lost: Lost) -> Iterable[Row]:
        return form.hold((row for row in log.rows() if row.channel in seen.channels), seen, lost)

    folder = target.parent / f"part-{os.getpid()}-{target.name}"
    folder.mkdir(parents=True)
    part = folder / target.name  # a ROS 2 bag's file has the name of its folder in it
    lost: Lost = Counter()
    try:
        form.write(part, held(lost), seen)
        losses = [Loss(count, what) for what, count in sorted(lost.items())]
        _refuse_nothing(form.name, log, seen, losses)
        proof = Proof()
        proof.compare(held(Counter()), form.read(part))
        proof.refuse_different(target)
        os.replace(part, target)
        return proof.frames, [*losses, *proof.losses()]
    finally:
        shutil.rmtree(folder)


def _refuse_nothing(name: str, log: Log, seen: Survey, losses: Sequence[Loss]) -> None:
    """Raise InputError where not one frame is left."""
    if sum(loss.frames for loss in losses if "left out" in loss.what) < seen.frames:
        return
    raise InputError(
        f"{name} can hold none of the {seen.frames} frames: {'; '.join(map(str, losses))}",
        code="nothing_left",
        file=str(log.path),
        hint="choose another format: candump, blf and csv hold every frame",
    )
