"""The page of a `gap` for people: one sentence on top, what to do next, tables, pictures.

The pictures of a `gap`: where, evidence, and of a proof errors, traces and what the residual looks like.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tunefree_hil.jobs.gap.report_text import UNJUDGED, listed, percent, remarks, value_words, waits_for_proof
from tunefree_hil.jobs.report_text import markdown_table
from tunefree_hil.jobs.run_folder import write_text

MOST_SUSPECTS = 10
GROUPS = {
    "along": "what acts along the car",
    "across": "what acts across it",
    "sensors": "its sensors",
}  # gap/validation/update_selection.py
CAPTIONS = {
    "where": "Where it is missed",
    "signature": "What it looks like, without and with the effect",
    "evidence": "Evidence",
    "traces": "Before and after",
    "shrink": "How the gap shrinks",
}


def write_page(path: Path, answer: Mapping[str, Any], following: Sequence[str], again: str) -> None:
    """Write gap.md; pictures are linked as they lie beside it."""
    lines = [f"# {answer['sentence']}", ""]
    lines += _next(answer, following) + _beside(answer) + _driven(answer)
    lines += _effects(answer) + _signals(answer) + _older(answer) + _pictures(path, answer) + _links(answer)
    lines += _suspects(answer) + _changes(answer) + _unseen(answer)
    lines += ["## Made of", "", *(f"- {one['name']} `{one['hash']}`" for one in answer["logs"])]
    lines += [f"- model `{answer['model_hash']}`, vehicle `{answer['vehicle_hash']}`, version {answer['version']}", ""]
    write_text(path, "\n".join([*lines, "```", again, "```", ""]))


def _next(answer: Mapping[str, Any], following: Sequence[str]) -> list[str]:
    lines = ["## What to do next", ""]
    if answer["separate_by"]:
        told = f"Drive {answer['separate_by']}; give that log beside these."
        lines += [
            told if answer.get("drives") else f"{told} `--drive --bench BENCH` has a bench of this vehicle do it.",
            "",
        ]
    if answer["verdict"] == "cannot_test":
        lines += [f"- {words}" for words in answer["words"]] + [""]
    if answer.get("worse"):
        lines += [
            "No model was written: it would be worse than the one before in "
            f"{', '.join(answer['worse'])}. An older log that was recorded before the effect came does not fit a model "
            "that has it: leave it out.",
            "",
        ]
    if answer.get("absorbed"):
        lines += [
            "The plant was learned: its net may have absorbed what these logs and those it learned from share.",
            "",
        ]
    return [*lines, "```", *following, "```", ""] if following else lines


def _beside(answer: Mapping[str, Any]) -> list[str]:
    """Why it is a set, what the drive lacked, what recalibration moved."""
    told = remarks(answer)
    return ["## To be known beside it", "", *(f"- {words}" for words in told), ""] if told else []


def _driven(answer: Mapping[str, Any]) -> list[str]:
    """What a bench drove for this answer (`--drive`)."""
    rows = [(str(one["round"]), one["words"], f"`{one['log']}`") for one in answer.get("drives", [])]
    if not rows:
        return []
    told = "The first answer, of the logs alone, is kept in gap-1.md and gap-1.json."
    return ["## What the bench drove", "", *markdown_table(("round", "manoeuvre", "log"), rows), told, ""]


def _effects(answer: Mapping[str, Any]) -> list[str]:
    if not answer["effects"]:
        return []
    proved = bool(answer.get("proof_blocks"))
    rows = [(one["name"], value_words(one), _number(one["evidence"]), _own(one, proved)) for one in answer["effects"]]
    head = ("effect", "value (95 %)", "evidence, nats", "off the error of its own signal")
    return ["## What is missing", "", *markdown_table(head, rows)]


def _own(effect: Mapping[str, Any], proved: bool) -> str:
    """What an effect takes off the signal that shows it best: where it was judged, and on the proof."""
    seen, unseen = effect.get("shrink"), effect.get("unseen_shrink")
    if seen is None:
        return ""
    told = f"{100.0 * seen:.0f} %"
    return told if unseen is None or not proved else f"{told}; {100.0 * unseen:.0f} % on the blocks that prove"


def _long(answer: Mapping[str, Any]) -> str:
    """How long a block of the proof is at least."""
    block_s = answer.get("block_s")
    return f" of {block_s:.3g} s" if block_s else ""


def _signals(answer: Mapping[str, Any]) -> list[str]:
    if not answer["signals"]:
        return []
    keys = {"before": "as it was", "recalibrated": "recalibration only", "after": "repaired"}
    if any(one.get("unforetold") is not None for one in answer["signals"].values()):
        keys["unforetold"] = "of that, foretold by nothing"
    keys["floor"] = "floor"
    rows = [(name, *(_number(one.get(key)) for key in keys), one["unit"]) for name, one in answer["signals"].items()]
    closed, count = answer.get("explained_frac"), answer.get("proof_blocks")
    told = f"Free runs of the whole car over {count} blocks{_long(answer)} that no fit and no choice has seen: "
    told += "recorded commands in, nothing put right within a block. Errors are root mean squares."
    lines = ["## Proof", "", told]
    if waits_for_proof(answer):
        lines.append("They do not show what is missing: another drive has to prove the repair.")
    elif closed:
        lines.append(f"The repair closes {percent(closed)} of what recalibration leaves above the floor.")
    if answer.get("explicable_frac"):
        lines.append(f"Of what anything in these logs could still have foretold: {percent(answer['explicable_frac'])}.")
    lines += _starts(answer) + _by_chance(answer)
    return [*lines, "", *markdown_table(("signal", *keys.values(), "unit"), rows), *_replay(answer)]


def _starts(answer: Mapping[str, Any]) -> list[str]:
    """Which numbers recalibration and repair have, where that is not said by the logs that were asked."""
    lines = []
    if answer.get("from_own_logs"):
        lines.append(
            "Both go out from the numbers that the model's own logs gave it (`own_numbers` in its card.json); "
            "as it was is the model as it lies in its folder."
        )
    if answer.get("does_not_pay"):
        what = listed([GROUPS[one] for one in answer["does_not_pay"]])
        lines.append(
            f"Recalibration on these logs leaves {what} alone: moved, it came no nearer on the blocks that choose."
        )
    return lines


def _by_chance(answer: Mapping[str, Any]) -> list[str]:
    """What a model that is kept misses by more than the one before, as far as so few blocks can tell."""
    grown = answer.get("grown") if answer.get("model") else None
    if not grown:
        return []
    told = ", ".join(f"{name} by {100.0 * by:.0f} %" for name, by in grown.items())
    return [f"Missed by more than as it was, but by no more than these blocks differ by chance: {told}."]


def _replay(answer: Mapping[str, Any]) -> list[str]:
    found = answer.get("closed_loop")
    if not found:
        words = answer.get("closed_loop_words")
        return [f"Closed loop: {words}.", ""] if words else []
    rows = [
        (name, *(_number(one[key]) for key in ("before", "recalibrated", "after")), one["unit"])
        for name, one in found["signals"].items()
    ]
    told = f"Closed loop, the same controller on the same road: {found['words']}."
    return [told, "", *markdown_table(("signal", "as it was", "recalibration only", "repaired", "unit"), rows)]


def _older(answer: Mapping[str, Any]) -> list[str]:
    lines = []
    for one in answer["older"]:
        rows = [
            (name, _number(s["before"]), _number(s["after"]), s["unit"], "worse" if name in one["worse"] else "")
            for name, s in one["signals"].items()
        ]
        table = markdown_table(("signal", "as it was", "repaired", "unit", ""), rows)
        lines += [f"## Older log {one['name']}", "", *(table if one.get("blocks", 1) else [UNJUDGED, ""])]
    return lines


def _pictures(path: Path, answer: Mapping[str, Any]) -> list[str]:
    lines = []
    for figure in map(Path, answer["figures"]):
        beside = figure.relative_to(path.parent).as_posix()
        lines += [f"## {CAPTIONS[figure.stem]}", "", f"![{CAPTIONS[figure.stem]}]({beside})", ""]
    return lines


def _links(answer: Mapping[str, Any]) -> list[str]:
    if not answer["links"]:
        return []
    rows = [
        (
            one["link"], one["signal"], _number(one["rms"]), _number(one["noise"]), one["unit"],
            f"{100.0 * one['share']:.1f} %", "broken" if one["broken"] else "",
        )
        for one in answer["links"]
    ]  # fmt: skip
    head = ("link", "signal", "missed (RMS)", "of it noise", "unit", "explicable, of the signal", "")
    lost = [f"- {link}: {words}" for link, words in answer["lost"].items()]
    return ["## Every link by itself", "", *markdown_table(head, rows), *lost, *([""] if lost else [])]


def _suspects(answer: Mapping[str, Any]) -> list[str]:
    some = sorted(answer["candidates"], key=lambda one: -(one["evidence"] or 0.0))[:MOST_SUSPECTS]
    if not some:
        return []
    rows = [
        (
            one["name"], _number(one["evidence"]), _number(one["held_out"][0]), one["signal"],
            f"{100.0 * (one['shrink'][0] or 0.0):.0f} %", "yes" if one["counts"] else "",
        )
        for one in some
    ]  # fmt: skip
    head = ("suspect", "evidence, nats", "on held-out blocks", "signal", "shrinks by", "counts")
    count = len(answer["candidates"])
    return [f"## The {len(some)} best of {count} suspects", "", *markdown_table(head, rows)]


def _changes(answer: Mapping[str, Any]) -> list[str]:
    if not answer.get("changes"):
        return []
    rows = [(f"`{one['key']}`", _number(one["before"]), _number(one["after"])) for one in answer["changes"]]
    return ["## The model, old and new", "", *markdown_table(("key", "before", "after"), rows)]


def _unseen(answer: Mapping[str, Any]) -> list[str]:
    lines = [
        f"- {name}: {', '.join(one['lacks'])}" for name, one in answer["excitation"].items() if not one["enough"]
    ] + [f"- {name}: {words}" for name, words in answer["not_suspected"].items()]
    return ["## What these logs cannot show", "", *lines, ""] if lines else []


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.4g}"


if TYPE_CHECKING:
    from tunefree_hil.figures.gap.gap_closed import Run
    from tunefree_hil.gap.result import Kept
    from tunefree_hil.gap.validation.holdout import Proof, Traces

FIELDS = {  # by target (gap/measured/targets.py): the signals that show it, the first that was measured is taken
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
    from tunefree_hil.figures.gap.links import Step, Where, write_ladder, write_where
    from tunefree_hil.gap.estimation.evidence import LEAST_NATS

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
    from tunefree_hil.figures.gap.gap_closed import Bars, write_runs, write_shrink, write_signature

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
    from tunefree_hil.jobs.gap.report_text import percent, waits_for_proof

    closed = answer.get("explained_frac")
    if waits_for_proof(answer):
        return "These blocks do not show what is missing: another drive has to prove the repair"
    if not closed:
        return "Free runs of the whole car on recorded commands, blocks that no fit has seen"
    return f"The repair closes {percent(closed)} of the gap that recalibration leaves"


def _run(blocks: Sequence[Traces], name: str, answer: Mapping[str, Any], only: Sequence[str] = VARIANTS) -> Run:
    """A signal over some blocks, one behind the other."""
    import numpy as np

    from tunefree_hil.figures.gap.gap_closed import Run

    variants = [one for one in blocks[0].simulated if one in only]
    return Run(
        name,
        answer["signals"][name]["unit"],
        np.concatenate([one.time_s for one in blocks]),
        np.concatenate([one.measured[name] for one in blocks if name in one.measured]),
        {key: np.concatenate([one.simulated[key][name] for one in blocks if name in one.measured]) for key in variants},
    )
