"""Figures of a `gap`: location and evidence; errors, traces and residuals on the holdout blocks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tunefree_hil.jobs.gap.acceptance import needs_further_drive
from tunefree_hil.jobs.gap.report_text import format_percent

if TYPE_CHECKING:
    from tunefree_hil.figures.gap.gap_closed import SignalTrace
    from tunefree_hil.gap.result import SearchResult
    from tunefree_hil.gap.validation.block_runs import BlockErrors, BlockTrace

SIGNALS = {  # by target (gap/measured/targets.py): signals that show it; the first one that was measured is drawn
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
ALWAYS_SHOWN = ("ins.speed_mps", "report.speed_mps", "ins.yaw_rate_radps", "report.yaw_rate_radps")
VARIANTS = ("before", "recalibrated", "after", "floor")
REPAIR_VARIANTS = ("recalibrated", "after")
MAX_PANELS = 3


def draw_figures(
    folder: Path, answer: Mapping[str, Any], search: SearchResult, holdout: BlockErrors | None
) -> list[Path]:
    """Draw every figure for which there are data. Returns: the files written."""
    paths = [*_draw_search(folder, answer, search)]
    if holdout is not None and holdout.n_blocks:
        paths += [*_draw_holdout(folder, answer, search, holdout)]
    return paths


def _draw_search(folder: Path, answer: Mapping[str, Any], search: SearchResult) -> Iterator[Path]:
    from tunefree_hil.figures.gap.links import CandidateEvidence, RegionMisfit, draw_evidence, draw_regions
    from tunefree_hil.figures.style import save
    from tunefree_hil.gap.estimation.evidence import MIN_EVIDENCE_NATS

    if search.regions:
        regions = [
            RegionMisfit(
                label=region.text,
                rms=region.rms,
                ratio=region.ratio,
                low=region.ratio_low,
                high=region.ratio_high,
                stands_out=region.stands_out,
            )
            for region in search.regions
        ]
        unit = next((link["unit"] for link in answer["links"] if link["signal"] == search.signal), "")
        title = f"Misfit of {search.signal} ({answer['where']['link']}) with recalibration alone"
        yield save(draw_regions(regions, "" if unit == "1" else unit, title), folder / "where.png")
    candidates = [
        CandidateEvidence(entry["name"], entry["evidence"], entry["held_out"][0], entry["counts"])
        for entry in answer["candidates"]
        if entry["evidence"] is not None and entry["held_out"][0] is not None
    ]
    if candidates:
        best = max(candidates, key=lambda candidate: (candidate.is_accepted, candidate.evidence))
        result = f"{best.name} explains the logs best" if best.is_accepted else "none passes every criterion"
        title = f"Of the {len(candidates)} best candidates, {result}"
        yield save(draw_evidence(candidates, MIN_EVIDENCE_NATS, title), folder / "evidence.png")


def _draw_holdout(
    folder: Path, answer: Mapping[str, Any], search: SearchResult, holdout: BlockErrors
) -> Iterator[Path]:
    from tunefree_hil.figures.gap.gap_closed import SignalErrors, draw_errors, draw_signature, draw_traces
    from tunefree_hil.figures.style import save

    errors = [
        SignalErrors(name, gap["unit"], {key: gap[key] for key in VARIANTS if gap[key] is not None})
        for name, gap in answer["signals"].items()
    ]
    yield save(draw_errors(errors, _gap_title(answer)), folder / "shrink.png")
    signals = SIGNALS.get(search.signal, ()) or tuple(answer.get("missed_in_proof") or ())
    block = select_block(holdout.traces, signals)
    first = [name for name in signals if name in block.measured][:1]
    further = [name for name in ALWAYS_SHOWN if name in block.measured and name not in first]
    shown = [*first, *further[:1], *(name for name in further if "yaw" in name)][:MAX_PANELS]
    traces = [_join_traces([block], name, answer) for name in shown or list(block.measured)[:1]]
    yield save(draw_traces(traces, "A holdout block: recorded commands in, no correction"), folder / "traces.png")
    if first and "after" in block.simulated:
        one_block = _join_traces([block], first[0], answer, REPAIR_VARIANTS)
        all_blocks = _join_traces(holdout.traces, first[0], answer, REPAIR_VARIANTS)
        title = f"Residual without and with {' and '.join(search.names)}"
        yield save(draw_signature(one_block, all_blocks, title), folder / "signature.png")


def select_block(blocks: Sequence[BlockTrace], names: Sequence[str]) -> BlockTrace:
    """The block in which recalibration alone misses most of a signal; the first block where it was not measured.

    Args:
        blocks: Traces of the holdout blocks.
        names: Signals in order of preference; the first one that was measured decides.
    """
    import numpy as np

    def misfit(block: BlockTrace) -> float:
        measured = [name for name in names if name in block.measured][:1]
        residuals = [block.simulated["recalibrated"][name] - block.measured[name] for name in measured]
        return sum(float(np.mean(residual**2)) for residual in residuals)

    return max(blocks, key=misfit)


def _gap_title(answer: Mapping[str, Any]) -> str:
    gap_share = answer.get("explained_frac")
    if needs_further_drive(answer):
        return "These blocks do not show what is missing: another drive has to confirm the repair"
    if not gap_share:
        return "Free runs of the whole vehicle on recorded commands, holdout blocks"
    return f"The repair closes {format_percent(gap_share)} of the gap that recalibration leaves"


def _join_traces(
    blocks: Sequence[BlockTrace], name: str, answer: Mapping[str, Any], variants: Sequence[str] = VARIANTS
) -> SignalTrace:
    """A signal over several blocks, one after the other."""
    import numpy as np

    from tunefree_hil.figures.gap.gap_closed import SignalTrace

    simulated = [variant for variant in blocks[0].simulated if variant in variants]
    having = [block for block in blocks if name in block.measured]
    return SignalTrace(
        name,
        answer["signals"][name]["unit"],
        np.concatenate([block.time_s for block in blocks]),
        np.concatenate([block.measured[name] for block in having]),
        {key: np.concatenate([block.simulated[key][name] for block in having]) for key in simulated},
    )
