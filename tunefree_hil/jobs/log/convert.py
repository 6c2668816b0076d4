"""Convert a log into another format, report what that format cannot store, and verify the result by reading it back.

The source is read three times, frame by frame: for the writer's header, for writing, and for the comparison. So a log
may be larger than the memory.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bus.formats.compare import Proof
from tunefree_hil.bus.formats.find import CANDUMP, format_for, load_format
from tunefree_hil.bus.formats.rows import Format, FormatLoss, Lost, Row, Survey, change, survey
from tunefree_hil.episode.candump import read_rows, write_candump
from tunefree_hil.jobs.log.files import LogFile, open_log
from tunefree_hil.jobs.log.options import LogConvertOptions


def convert(options: LogConvertOptions) -> Iterator[Event]:
    """Write the target in the format of its suffix (or `options.to`); a warning for each kind of loss.

    Raises:
        InputError: There is nothing to write, or the target already exists.
        BenchError: The written file differs from the source when it is read back.
    """
    source, target = options.source, options.target
    name = format_for(target, options.to)
    if target.exists():
        raise InputError("already exists", code="exists", file=str(target), hint="choose another name, or move it")
    form = _load_format(name)
    log = open_log(source)
    whole = survey(log.rows())
    yield Event("note", f"{source}: {log.format}, {whole.frames} frames on {', '.join(sorted(whole.channels))}")
    selected = _select_channels(log, whole, options.channels)
    written, losses = _write(form, target, log, selected)
    for loss in losses:
        yield Event("warning", f"{name}: {loss}")
    skipped = whole.frames - selected.frames
    data = {
        "format": name,
        "read": whole.frames,
        "not_chosen": skipped,
        "written": written,
        "losses": [loss._asdict() for loss in losses],
        "out": str(target),
    }
    lost = f"; {len(losses)} kinds of loss, listed above" if len(losses) > 1 else f"; {losses[0]}" if losses else ""
    aside = f" ({skipped} on other channels)" if skipped else ""
    yield Event("result", "", {**data, "sentence": f"{written} of {whole.frames} frames{aside} in {target}{lost}"})


def _load_format(name: str) -> Format:
    if name != CANDUMP:
        return load_format(name)
    return Format(CANDUMP, read_rows, write_candump, _fit_candump)


def _fit_candump(rows: Iterable[Row], selected: Survey, lost: Lost) -> Iterable[Row]:
    """Rows as candump stores them: channel names must be one word."""
    words = {name: "_".join(name.split()) or "can0" for name in selected.channels}
    if all(name == word for name, word in words.items()):
        return rows
    text = "the channel's name is changed to one word"
    return change(rows, lambda row: row._replace(channel=words[row.channel]), text, lost)


def _select_channels(log: LogFile, whole: Survey, channels: Sequence[str]) -> Survey:
    """Survey of the rows of some channels. Raises InputError for an unknown channel."""
    for channel in channels:
        if channel not in whole.channels:
            message = f"the log has no channel {channel!r}"
            hint = f"its channels are {', '.join(sorted(whole.channels))}"
            raise InputError(message, code="no_channel", file=str(log.path), key="--channel", hint=hint)
    if not channels or whole.channels.keys() <= set(channels):
        return whole
    return survey(row for row in log.rows() if row.channel in channels)


def _write(form: Format, target: Path, log: LogFile, selected: Survey) -> tuple[int, list[FormatLoss]]:
    """Write a part file, compare it with the source, and rename it. Returns the number of frames, and the losses."""

    def storable_rows(lost: Lost) -> Iterable[Row]:
        return form.hold((row for row in log.rows() if row.channel in selected.channels), selected, lost)

    folder = target.parent / f"part-{os.getpid()}-{target.name}"
    folder.mkdir(parents=True)
    part = folder / target.name  # the file name of a ROS 2 bag contains that of its folder
    lost = Lost()
    try:
        form.write(part, storable_rows(lost), selected)
        losses = [FormatLoss(count, text) for text, count in sorted(lost.items())]
        _require_frames(form.name, log, selected, losses, lost.left_out)
        proof = Proof()
        proof.compare(storable_rows(Lost()), form.read(part))
        proof.refuse_different(target)
        os.replace(part, target)
        return proof.frames, [*losses, *proof.losses()]
    finally:
        shutil.rmtree(folder)


def _require_frames(name: str, log: LogFile, selected: Survey, losses: Sequence[FormatLoss], left_out: int) -> None:
    """Raise InputError where no frame is left."""
    if left_out < selected.frames:
        return
    message = f"{name} can store none of the {selected.frames} frames: {'; '.join(map(str, losses))}"
    hint = "choose another format: candump, blf and csv store every frame"
    raise InputError(message, code="nothing_left", file=str(log.path), hint=hint)
