"""Whether logs hold enough to be asked for a name: long enough, and driven."""

from __future__ import annotations

from collections.abc import Sequence

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.records import GEAR_DRIVE
from tunefree_hil.gap.chain import Opened
from tunefree_hil.gap.graph import CHANNELS
from tunefree_hil.gap.lost import OUTPUTS
from tunefree_hil.gap.segments import BLOCK_S, FEWEST, FEWEST_DRIVEN, GUARD_S, SHORTEST_S, Blocks, block_s_of, blocks_of
from tunefree_hil.gap.targets import LEAST_MPS

LEAST_TOLD = 0.05  # of the time, that a cause is named
LEAST_S = FEWEST * SHORTEST_S * (1.0 + GUARD_S / BLOCK_S)  # that a question's logs have to hold


def refuse_untold(drives: Sequence[Opened]) -> None:
    """Raises InputError for logs that are too short, and for a car that stands: its few moving rows would be all that
    is fitted to.
    """
    ticks, dt_s = [one.ticks for one in drives], drives[0].dt_s
    blocks, block_s = blocks_of(ticks, dt_s), block_s_of(ticks, dt_s)
    if blocks.count < FEWEST:
        held = f"{blocks.count} blocks of {block_s:.3g} s"
        raise InputError(
            f"the logs hold {held}; {FEWEST} are needed to fit, to choose and to prove",
            code="too_short",
            key="LOG",
            hint=f"record {LEAST_S:.0f} s or more; twice that tells more",
        )
    driven = sum(_driven(one, blocks, i) for i, one in enumerate(drives))
    if driven < FEWEST_DRIVEN:
        raise InputError(
            f"the car moves above walking pace in {driven} stretches of {block_s:.3g} s, as far as the logs say; "
            f"{FEWEST_DRIVEN} are needed{_why(drives)}",
            code="standing",
            key="LOG",
            hint=f"drive for {LEAST_S:.0f} s or more, in gear, with the by-wire unit obeying; a report that falls "
            "silent is worse than none: a log that has it nowhere is read without it",
        )


def _why(drives: Sequence[Opened]) -> str:
    """What takes most of the time away from driving, the greatest first, in words; '' where nothing does."""
    seconds: dict[str, float] = {}
    for one in drives:
        source = "ins.speed_mps" if one.inputs.by_ins else "report.speed_mps"
        names = [source, *(f"report.{OUTPUTS[channel]}" for channel in CHANNELS)]
        causes = {f"{name} is silent": ~one.signals[name].there for name in names if name in one.signals}
        causes["the car stands"] = one.inputs.speed_mps <= LEAST_MPS * one.pace
        causes["it is in no forward gear"] = one.inputs.gear < GEAR_DRIVE
        for words, rows in causes.items():
            seconds[words] = seconds.get(words, 0.0) + float(rows.sum()) * one.dt_s
    whole = sum(one.ticks * one.dt_s for one in drives)
    most = sorted((some, words) for words, some in seconds.items() if some > LEAST_TOLD * whole)[::-1]
    said = ", ".join(f"{words} for {some:.0f} s" for some, words in most)
    return f" (of {whole:.0f} s {said})" if said else ""


def _driven(one: Opened, blocks: Blocks, drive: int) -> int:
    """Blocks of a drive in which the car drives most of the time."""
    moves, mine = one.moving & (one.inputs.speed_mps > LEAST_MPS * one.pace), blocks.drives == drive
    ends = zip(blocks.begins[mine], blocks.ends[mine], strict=True)
    return sum(bool(moves[begin:end].mean() > 0.5) for begin, end in ends)
