"""Splits drives into a training set and a held-out set, without gaps, and without neighbouring rows in both.

Whole drives are held out where there are at least three recordings. Of one or two, blocks are held out, with an unused
guard on each side, because neighbouring rows are nearly equal.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import maximum_filter1d

from tunefree_hil.base.errors import InputError
from tunefree_hil.learn.drives.drive import Array, Drive, DrivePart, DriveSplit
from tunefree_hil.learn.drives.runs import find_runs, sample_interval_ticks


class SplitCriteria(NamedTuple):
    """Sizes of a split; every value is an engineering choice."""

    held_out_share: float = 0.2  # of the time, that is held out
    min_recordings: int = 3  # from which on whole drives are held out
    block_s: float = 20.0  # length of a block that is held out or trained on
    min_blocks: int = 3  # of a drive that is cut; a shorter drive has shorter blocks
    min_block_s: float = 5.0  # a drive that gives shorter blocks is too short
    guard_s: float = 2.0  # on each side of a held-out block
    min_part_s: float = 1.0  # a shorter part without gaps is left out
    max_lateness_s: float = 0.02  # beyond its period, after which a missing field has a gap


SPLIT = SplitCriteria()


class _Division(NamedTuple):
    """Training and held-out parts, still with gaps."""

    training: list[DrivePart]
    held_out: list[DrivePart]
    description: str


def split_drives(
    drives: Sequence[Drive],
    *,
    held_out: float = SPLIT.held_out_share,
    seed: int,
    needed: Sequence[str] = (),
    min_part_s: float = SPLIT.min_part_s,
) -> DriveSplit:
    """Hold out about a share of the time, at least one drive or block; the same for the same seed.

    Recordings with the same bytes stay together; with one or two recordings only the first copy is used.

    Args:
        held_out: share of the time that is held out.
        needed: fields in whose gaps a part ends (find_complete_parts).
        min_part_s: shorter parts are left out.

    Raises:
        InputError: there is not enough data to hold any out.
    """
    if not 0.0 < held_out <= 0.5:
        message = f"the held-out share is {held_out:g}, but it must be above 0 and at most 0.5"
        raise InputError(message, code="bad_share", key="held_out", hint=f"use {SPLIT.held_out_share:g}")
    rng = np.random.default_rng(seed)
    recordings: dict[str, list[Drive]] = {}
    for i, drive in enumerate(drives):
        recordings.setdefault(drive.log_hash or f"made {i}", []).append(drive)
    if len(recordings) >= SPLIT.min_recordings:
        division = _split_by_drive(list(recordings.values()), held_out, rng)
    else:
        division = _split_by_block([copies[0] for copies in recordings.values()], held_out, rng)
    split = DriveSplit(
        _without_gaps(division.training, needed, min_part_s),
        _without_gaps(division.held_out, needed, min_part_s),
        f"{division.description} (seed {seed})",
    )
    _require_parts(split, needed, min_part_s)
    return split


def find_complete_parts(drive: Drive, needed: Sequence[str], min_part_s: float = SPLIT.min_part_s) -> list[DrivePart]:
    """The stretches in which every needed field is present, at least min_part_s long; none where one is absent.

    A frame counts for one period, which is the usual distance between two frames of the field in this drive. The next
    frame may be late by SplitCriteria.max_lateness_s; after that there is a gap. A value that is not finite is a gap.
    """
    is_complete = np.ones(drive.n_rows, dtype=bool)
    for name in needed:
        is_complete &= _present_rows(drive, name)
    min_s = min_part_s - 1e-9
    return [
        DrivePart(drive, begin, end) for begin, end in find_runs(is_complete) if (end - begin) * drive.dt_s >= min_s
    ]


def _present_rows(drive: Drive, name: str) -> Array:
    values, fresh = drive.get(name), drive.fresh.get(name)
    is_present = np.zeros(drive.n_rows, dtype=bool)
    if values is None or fresh is None:
        return is_present
    rows = np.flatnonzero(fresh)
    if not len(rows):
        return is_present
    period = round(sample_interval_ticks(fresh))
    allowed = period + SPLIT.max_lateness_s / drive.dt_s
    following = np.append(rows[1:], drive.n_rows)
    ends = np.where(following - rows > allowed + 1e-6, np.minimum(rows + period, following), following)
    edges = np.zeros(drive.n_rows + 1, dtype=np.int64)
    np.add.at(edges, rows, 1)
    np.add.at(edges, ends, -1)
    is_present[:] = np.cumsum(edges[:-1]) > 0
    return is_present & np.isfinite(values)


def _split_by_drive(recordings: list[list[Drive]], held_out: float, rng: np.random.Generator) -> _Division:
    """Hold out drives in random order as long as that brings their time nearer to the share."""
    durations_s = [sum(_duration_s(drive) for drive in copies) for copies in recordings]
    target_s, chosen_s, chosen = held_out * sum(durations_s), 0.0, set[int]()
    for i in rng.permutation(len(recordings)).tolist():
        if abs(chosen_s + durations_s[i] - target_s) < abs(chosen_s - target_s):
            chosen.add(i)
            chosen_s += durations_s[i]
    if not chosen:  # each recording is longer than twice the wanted time
        shortest = min(range(len(durations_s)), key=durations_s.__getitem__)
        chosen, chosen_s = {shortest}, durations_s[shortest]
    training = [_whole_drive(drive) for i, copies in enumerate(recordings) if i not in chosen for drive in copies]
    held_out_parts = [_whole_drive(drive) for i, copies in enumerate(recordings) if i in chosen for drive in copies]
    share = 100.0 * chosen_s / max(sum(durations_s), 1e-9)
    names = ", ".join(part.drive.name for part in held_out_parts)
    count = f"{len(held_out_parts)} of {len(held_out_parts) + len(training)} drives"
    return _Division(training, held_out_parts, f"{count} held out, {share:.0f} % of the time: {names}")


def _split_by_block(drives: Sequence[Drive], held_out: float, rng: np.random.Generator) -> _Division:
    """Hold out one random block of each group of neighbouring blocks of each drive."""
    training: list[DrivePart] = []
    held_out_parts: list[DrivePart] = []
    counts = []
    for drive in drives:
        edges = _block_edges(drive)
        count = len(edges) - 1
        groups = np.array_split(np.arange(count), max(1, round(held_out * count)))
        chosen = [int(rng.choice(group)) for group in groups]
        is_held_out = np.zeros(drive.n_rows, dtype=bool)
        for block in chosen:
            is_held_out[edges[block] : edges[block + 1]] = True
        held_out_parts += [DrivePart(drive, *span) for span in find_runs(is_held_out)]
        is_guarded = np.asarray(maximum_filter1d(is_held_out, 2 * round(SPLIT.guard_s / drive.dt_s) + 1), dtype=bool)
        training += [DrivePart(drive, *span) for span in find_runs(~is_guarded)]
        block_s = float(edges[1] - edges[0]) * drive.dt_s
        counts.append(f"{len(chosen)} of {count} blocks of {block_s:.0f} s of {drive.name}")
    guard = f"{SPLIT.guard_s:g} s on each side of them are not used"
    drive_count = "one drive only" if len(drives) == 1 else f"{len(drives)} drives only"
    return _Division(
        training,
        held_out_parts,
        f"{drive_count}: {', '.join(counts)} held out, {guard}; a separate drive would be a stricter test",
    )


def _block_edges(drive: Drive) -> list[int]:
    """The first row of each block, and the number of rows; the last block takes the remainder."""
    duration_s = _duration_s(drive)
    count = math.floor(duration_s / SPLIT.block_s + 1e-9)
    block_s = SPLIT.block_s if count >= SPLIT.min_blocks else duration_s / SPLIT.min_blocks
    if block_s < SPLIT.min_block_s:
        min_s = SPLIT.min_blocks * SPLIT.min_block_s
        raise InputError(
            f"{drive.name} lasts {duration_s:.1f} s: too short to hold a part of it out",
            code="too_short",
            key=drive.name,
            hint=f"record at least {min_s:g} s, or give at least {SPLIT.min_recordings} logs",
        )
    count = max(count, SPLIT.min_blocks)
    return [round(i * block_s / drive.dt_s) for i in range(count)] + [drive.n_rows]


def _without_gaps(parts: Sequence[DrivePart], needed: Sequence[str], min_part_s: float) -> tuple[DrivePart, ...]:
    """The parts, cut where a needed field has a gap."""
    pieces = []
    for part in parts:
        for complete in find_complete_parts(part.drive, needed, 0.0):
            begin, end = max(part.begin, complete.begin), min(part.end, complete.end)
            if end > begin and (end - begin) * part.drive.dt_s >= min_part_s - 1e-9:
                pieces.append(DrivePart(part.drive, begin, end))
    return tuple(pieces)


def _require_parts(split: DriveSplit, needed: Sequence[str], min_part_s: float) -> None:
    for parts, purpose in ((split.training, "training"), (split.held_out, "the held-out test")):
        if not parts:
            fields = f" in which {', '.join(needed)} have no gap" if needed else ""
            raise InputError(
                f"no data is left for {purpose}: there is no stretch of {min_part_s:g} s{fields}",
                code="too_short",
                hint="record longer, or run `tunefree-hil log check` to see what is missing in the logs",
            )


def _whole_drive(drive: Drive) -> DrivePart:
    return DrivePart(drive, 0, drive.n_rows)


def _duration_s(drive: Drive) -> float:
    return drive.n_rows * drive.dt_s
