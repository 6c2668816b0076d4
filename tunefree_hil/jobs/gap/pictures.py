"""The pictures of a `gap`: where, evidence, and of a proof errors, traces and what the residual looks like."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tunefree_hil.figures.gap_shrink import Run
    from tunefree_hil.gap.kept import Kept
    from tunefree_hil.gap.verify import Proof, Traces

FIELDS = {  # by target (gap/targets.py): the signals that show it, the first that was measured is taken
    "throttle": ("report.throttle_frac",),
    "brake": ("report.brake_frac",),
    "steer": ("report.steer_rad",),
    "rate_of_speed": ("ins.speed_mps", "report.speed_mps"),
    "yaw_rate": ("ins.yaw_rate_radps", "report.yaw_rate_radps"),
    "lateral_beyond_turning": ("report.lateral_accel_mps2",),
    "lateral_accel": ("report.lateral_accel_mps2",),
    "wheel_vs_ins": ("report.speed_mps",),
    "yaw_vs_ins": ("report.yaw_rate_radps",),
    "accel_vs_dvdt": ("report.accel_mps2",),
}
ALWAYS = ("ins.speed_mps", "report.speed_mps", "ins.yaw_rate_radps", "report.yaw_rate_radps")
VARIANTS = ("before", "recalibrated", "after", "floor")
REPAIR = ("recalibrated", "after")
MOST_PANELS = 3


def draw(folder: Path, answer: Mapping[str, Any], found: Kept, proof: Proof | None) -> list[Path]:
    """All that there is something to see in; those that were written."""
    drawn = [*_located(folder, answer, found)]
    if proof is not None and proof.blocks:
        drawn += [*_proved(folder, answer, found, proof)]
    return drawn


def _located(folder: Path, answer: Mapping[str, Any], found: Kept) -> Iterator[Path]:
    from tunefree_hil.figures.gap import Step, Where, write_ladder, write_where
    from tunefree_hil.gap.evidence import LEAST_NATS

    if found.regions:
        regions = [
            Where(one.words, one.rms, one.ratio, one.ratio_low, one.ratio_high, one.stands_out) for one in found.regions
        ]
        unit = next((one["unit"] for one in answer["links"] if one["signal"] == found.signal), "")
        words = f"Where {found.signal} is missed ({answer['where']['link']}) by recalibration alone"
        yield write_where(folder / "where.png", regions, "" if unit == "1" else unit, words)
    steps = [
        Step(one["name"], one["evidence"], one["held_out"][0], one["counts"])
        for one in answer["candidates"]
        if one["evidence"] is not None and one["held_out"][0] is not None
    ]
    if steps:
        best = max(steps, key=lambda one: (one.counts, one.evidence))
        words = f"{best.name} explains it best" if best.counts else "none passes every test"
        yield write_ladder(
            folder / "evidence.png", steps, LEAST_NATS, f"Of {len(steps)} suspects that came near, {words}"
        )


def _proved(folder: Path, answer: Mapping[str, Any], found: Kept, proof: Proof) -> Iterator[Path]:
    from tunefree_hil.figures.gap_shrink import Bars, write_runs, write_shrink, write_signature

    bars = [
        Bars(name, one["unit"], {key: one[key] for key in VARIANTS if one[key] is not None})
        for name, one in answer["signals"].items()
    ]
    yield write_shrink(folder / "shrink.png", bars, _title(answer))
    fields = FIELDS.get(found.signal, ()) or tuple(answer.get("missed_in_proof") or ())
    block = telling(proof.traces, fields)
    own = [name for name in fields if name in block.measured][:1]
    others = [name for name in ALWAYS if name in block.measured and name not in own]
    shown = [*own, *others[:1], *(name for name in others if "yaw" in name)][:MOST_PANELS]
    runs = [_run([block], name, answer) for name in shown or list(block.measured)[:1]]
    yield write_runs(folder / "traces.png", runs, "A block of the proof: recorded commands in, no correction")
    if own and "after" in block.simulated:
        names = " and ".join(found.names)
        stretch, whole = _run([block], own[0], answer, REPAIR), _run(proof.traces, own[0], answer, REPAIR)
        yield write_signature(folder / "signature.png", stretch, whole, f"What is missed without and with {names}")


def telling(blocks: Sequence[Traces], names: Sequence[str]) -> Traces:
    """The block in which recalibration alone misses most of the first of some signals that was measured; the first one
    where none was. In a block without a braking nobody sees what a brake lacks.
    """
    import numpy as np

    def missed(one: Traces) -> float:
        some = [name for name in names if name in one.measured][:1]
        return sum(float(np.mean((one.simulated["recalibrated"][name] - one.measured[name]) ** 2)) for name in some)

    return max(blocks, key=missed)


def _title(answer: Mapping[str, Any]) -> str:
    from tunefree_hil.jobs.gap.words import percent, waits_for_proof

    closed = answer.get("explained_frac")
    if waits_for_proof(answer):
        return "These blocks do not show what is missing: another drive has to prove the repair"
    if not closed:
        return "Free runs of the whole car on recorded commands, blocks that no fit has seen"
    return f"The repair closes {percent(closed)} of the gap that recalibration leaves"


def _run(blocks: Sequence[Traces], name: str, answer: Mapping[str, Any], only: Sequence[str] = VARIANTS) -> Run:
    """A signal over some blocks, one behind the other."""
    import numpy as np

    from tunefree_hil.figures.gap_shrink import Run

    variants = [one for one in blocks[0].simulated if one in only]
    return Run(
        name,
        answer["signals"][name]["unit"],
        np.concatenate([one.time_s for one in blocks]),
        np.concatenate([one.measured[name] for one in blocks if name in one.measured]),
        {key: np.concatenate([one.simulated[key][name] for one in blocks if name in one.measured]) for key in variants},
    )
