"""Which rows are learned from and which judge what was learned: never neighbours, never a gap inside.

Whole drives are held out where there are three or more. With one or two, blocks of them are, with a guard on each side
that nobody uses: rows next to each other are nearly the same measurement.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.learn.drives.drive import Drive, Part, Split
from tunefree_hil.learn.drives.runs import every_of, runs

Array = np.ndarray

FEWEST_DRIVES = 3
BLOCK_S = 20.0
FEWEST_BLOCKS = 3  # of a drive that is cut; where it is too short for so many, its blocks are shorter
SHORTEST_BLOCK_S = 5.0
GUARD_S = 2.0
LEAST_S = 1.0
SLACK_S = 0.02  # beyond its period, after which a field that does not come has a gap
HELD_OUT = 0.2


def split_drives(
    drives: Sequence[Drive],
    *,
    held_out: float = HELD_OUT,
    seed: int,
    needed: Sequence[str] = (),
    least_s: float = LEAST_S,
) -> Split:
    """About a share `held_out` of the time to judge by, at least one drive (or block); the same for the same seed.

    Recordings of the same bytes stay together (of one or two, only the first is used). needed: fields in whose gaps a
    part ends (parts_of). Parts below least_s are dropped. Raises InputError where there is not enough to
    hold anything out.
    """
    if not 0.0 < held_out <= 0.5:
        raise InputError(
            f"{held_out:g} of the time cannot be held out", code="bad_share", key="held_out", hint="0.2 is usual"
        )
    chance = np.random.default_rng(seed)
    recordings: dict[str, list[Drive]] = {}
    for i, drive in enumerate(drives):
        recordings.setdefault(drive.log_hash or f"made {i}", []).append(drive)
    if len(recordings) >= FEWEST_DRIVES:
        training, judging, words = _by_drive(list(recordings.values()), held_out, chance)
    else:
        training, judging, words = _by_block([some[0] for some in recordings.values()], held_out, chance)
    split = Split(_whole(training, needed, least_s), _whole(judging, needed, least_s), f"{words} (seed {seed})")
    _refuse_nothing(split, needed, least_s)
    return split


def parts_of(drive: Drive, needed: Sequence[str], least_s: float = LEAST_S) -> list[Part]:
    """The stretches in which every needed field is there, at least least_s long; none where the drive lacks a field.

    A field is there from its first frame on, until its period is over without a new one; a silence is a gap from
    SLACK_S beyond the period on. The period is the usual distance between two of its frames in this drive. A value that
    is no finite number is a gap too.
    """
    good = np.ones(drive.ticks, dtype=bool)
    for name in needed:
        good &= _there(drive, name)
    return [Part(drive, begin, end) for begin, end in runs(good) if (end - begin) * drive.dt_s >= least_s - 1e-9]


def _there(drive: Drive, name: str) -> Array:
    values, fresh = drive.get(name), drive.fresh.get(name)
    there = np.zeros(drive.ticks, dtype=bool)
    if values is None or fresh is None:
        return there
    rows = np.flatnonzero(fresh)
    if not len(rows):
        return there
    period = round(every_of(fresh))
    allowed = period + SLACK_S / drive.dt_s
    following = np.append(rows[1:], drive.ticks)
    until = np.where(following - rows > allowed + 1e-6, np.minimum(rows + period, following), following)
    edges = np.zeros(drive.ticks + 1, dtype=np.int64)
    np.add.at(edges, rows, 1)
    np.add.at(edges, until, -1)
    there[:] = np.cumsum(edges[:-1]) > 0
    return there & np.isfinite(values)


def _by_drive(
    recordings: list[list[Drive]], held_out: float, chance: np.random.Generator
) -> tuple[list[Part], list[Part], str]:
    """Drives in an order of chance are held out as long as that brings their time nearer to the share wanted."""
    times = [sum(_duration_s(drive) for drive in some) for some in recordings]
    wanted_s, held_s, held = held_out * sum(times), 0.0, set[int]()
    for i in chance.permutation(len(recordings)).tolist():
        if abs(held_s + times[i] - wanted_s) < abs(held_s - wanted_s):
            held.add(i)
            held_s += times[i]
    if not held:  # each is longer than twice what is wanted
        shortest = min(range(len(times)), key=times.__getitem__)
        held, held_s = {shortest}, times[shortest]
    training = [_all_of(drive) for i, some in enumerate(recordings) if i not in held for drive in some]
    judging = [_all_of(drive) for i, some in enumerate(recordings) if i in held for drive in some]
    share = 100.0 * held_s / max(sum(times), 1e-9)
    names = ", ".join(part.drive.name for part in judging)
    count = f"{len(judging)} of {len(judging) + len(training)} drives"
    return training, judging, f"{count} held out, {share:.0f} % of the time: {names}"


def _by_block(
    drives: Sequence[Drive], held_out: float, chance: np.random.Generator
) -> tuple[list[Part], list[Part], str]:
    """Of each drive one block out of each group of neighbours, chosen by chance."""
    training: list[Part] = []
    judging: list[Part] = []
    said = []
    for drive in drives:
        edges = _block_edges(drive)
        count = len(edges) - 1
        groups = np.array_split(np.arange(count), max(1, round(held_out * count)))
        chosen = [int(chance.choice(group)) for group in groups]
        judged = np.zeros(drive.ticks, dtype=bool)
        for block in chosen:
            judged[edges[block] : edges[block + 1]] = True
        judging += [Part(drive, *span) for span in runs(judged)]
        training += [Part(drive, *span) for span in runs(~_widened(judged, round(GUARD_S / drive.dt_s)))]
        block_s = float(edges[1] - edges[0]) * drive.dt_s
        said.append(f"{len(chosen)} of {count} blocks of {block_s:.0f} s of {drive.name}")
    guard = f"{GUARD_S:g} s on each side of them are not used"
    few = "one drive only" if len(drives) == 1 else f"{len(drives)} drives only"
    return training, judging, f"{few}: {', '.join(said)} held out, {guard}; a drive of its own would judge harder"


def _block_edges(drive: Drive) -> list[int]:
    """Rows at which blocks begin, and the end; the last block takes what is left over."""
    duration_s = _duration_s(drive)
    count = math.floor(duration_s / BLOCK_S + 1e-9)
    block_s = BLOCK_S if count >= FEWEST_BLOCKS else duration_s / FEWEST_BLOCKS
    if block_s < SHORTEST_BLOCK_S:
        raise InputError(
            f"{drive.name} lasts {duration_s:.1f} s: too short to hold a part of it out",
            code="too_short",
            key=drive.name,
            hint=f"record at least {FEWEST_BLOCKS * SHORTEST_BLOCK_S:g} s, or give {FEWEST_DRIVES} logs or more",
        )
    count = max(count, FEWEST_BLOCKS)
    return [round(i * block_s / drive.dt_s) for i in range(count)] + [drive.ticks]


def _widened(rows: Array, by: int) -> Array:
    """True also within `by` rows of what is True."""
    wide = np.zeros(len(rows), dtype=bool)
    for begin, end in runs(rows):
        wide[max(0, begin - by) : end + by] = True
    return wide


def _whole(parts: Sequence[Part], needed: Sequence[str], least_s: float) -> tuple[Part, ...]:
    """The parts without the gaps of the fields needed."""
    found = []
    for part in parts:
        for whole in parts_of(part.drive, needed, 0.0):
            begin, end = max(part.begin, whole.begin), min(part.end, whole.end)
            if end > begin and (end - begin) * part.drive.dt_s >= least_s - 1e-9:
                found.append(Part(part.drive, begin, end))
    return tuple(found)


def _refuse_nothing(split: Split, needed: Sequence[str], least_s: float) -> None:
    for parts, what in ((split.training, "learn from"), (split.held_out, "judge by")):
        if not parts:
            fields = f" in which {', '.join(needed)} come without a gap" if needed else ""
            raise InputError(
                f"nothing is left to {what}: there is no stretch of {least_s:g} s{fields}",
                code="too_short",
                hint="record longer, or find out with `tunefree-hil log check` what is missing in the logs",
            )


def _all_of(drive: Drive) -> Part:
    return Part(drive, 0, drive.ticks)


def _duration_s(drive: Drive) -> float:
    return drive.ticks * drive.dt_s
