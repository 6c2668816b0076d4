"""The page of a `gap` (gap.md): the sentence, what to do next, tables, figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tunefree_hil.gap.result_text import STAGE_TEXTS, candidate_text
from tunefree_hil.gap.selection.reasons import Reason, RejectionStage, reason_from_entry
from tunefree_hil.jobs.gap.acceptance import needs_further_drive
from tunefree_hil.jobs.gap.report_text import (
    CANNOT_TEST,
    NOT_DRIVABLE,
    describe_parameters,
    format_percent,
    join_names,
    list_remarks,
)
from tunefree_hil.jobs.report_text import markdown_table
from tunefree_hil.jobs.run_folder import write_text

MAX_CANDIDATES, MAX_REJECTED = 10, 5  # that are listed
STAGE = "stage"  # key of a reason against a candidate; the verdict's reasons have none
GROUP_NAMES = {  # of gap/validation/update_selection.py
    "along": "the longitudinal parameters",
    "across": "the lateral parameters",
    "sensors": "the sensor parameters",
}
CAPTIONS = {
    "where": "Where the misfit is",
    "signature": "Residual without and with the effect",
    "evidence": "Evidence",
    "traces": "Before and after",
    "shrink": "How the gap shrinks",
}


def write_page(path: Path, answer: Mapping[str, Any], following: Sequence[str], command: str) -> None:
    """Write gap.md; figures are linked relative to it.

    Args:
        path: File to write.
        answer: Content of gap.json.
        following: Commands to go on with.
        command: The command that makes this answer.
    """
    lines = [f"# {answer['sentence']}", ""]
    lines += _next_step_lines(answer, following) + _remark_lines(answer) + _reason_lines(answer) + _drive_lines(answer)
    lines += _effect_lines(answer) + _holdout_lines(answer) + _older_log_lines(answer) + _figure_lines(path, answer)
    lines += (
        _link_lines(answer)
        + _candidate_lines(answer)
        + _rejection_lines(answer)
        + _change_lines(answer)
        + _unobservable_lines(answer)
    )
    lines += ["## Made from", "", *(f"- {log['name']} `{log['hash']}`" for log in answer["logs"])]
    lines += [f"- model `{answer['model_hash']}`, vehicle `{answer['vehicle_hash']}`, version {answer['version']}", ""]
    write_text(path, "\n".join([*lines, "```", command, "```", ""]))


def _next_step_lines(answer: Mapping[str, Any], following: Sequence[str]) -> list[str]:
    lines = ["## What to do next", ""]
    if answer["separate_by"]:
        drive = f"Drive {answer['separate_by']}; give that log beside these."
        by_bench = "" if answer.get("drives") else " `--drive --bench BENCH` lets a bench of this vehicle drive it."
        lines += [drive + by_bench, ""]
    if answer["verdict"] == CANNOT_TEST:
        lines += [f"- {text}" for text in answer["words"]] + [""]
    if answer.get("worse"):
        lines += [
            f"No model is written: it would be worse than the original in {', '.join(answer['worse'])}. An older log "
            "that was recorded before the effect appeared does not fit a model with the effect: leave it out.",
            "",
        ]
    if answer.get("absorbed"):
        lines += [
            "The plant is learned: its net may have absorbed effects that its training logs share with these.",
            "",
        ]
    return [*lines, "```", *following, "```", ""] if following else lines


def _remark_lines(answer: Mapping[str, Any]) -> list[str]:
    remarks = list_remarks(answer)
    return ["## Remarks", "", *(f"- {text}" for text in remarks), ""] if remarks else []


def _reason_lines(answer: Mapping[str, Any]) -> list[str]:
    """The criteria behind the verdict (gap/selection/reasons.py), with the numbers compared."""
    rows = [
        (
            entry["name"],
            entry["criterion"].replace("_", " "),
            entry.get("signal", ""),
            _format_number(entry.get("value")),
            _format_number(entry.get("limit")),
        )
        for entry in answer.get("reasons", ())
        if STAGE not in entry
    ]
    head = ("effect", "criterion", "signal or parameter", "value", "limit")
    return ["## Reasons of the verdict", "", *markdown_table(head, rows)] if rows else []


def _rejection_lines(answer: Mapping[str, Any]) -> list[str]:
    """How many effects the search rejects at which stage, and where those with the most evidence fail at last."""
    reasons = [reason_from_entry(entry) for entry in answer.get("reasons", ()) if STAGE in entry]
    last = dict[str, Reason]()
    for reason in reasons:
        before = last.get(reason.name)
        if before is None or (before.stage, before.beside) != (reason.stage, reason.beside):
            last[reason.name] = reason  # the first criterion that it fails there
    if not last:
        return []
    names = {stage: {reason.name for reason in reasons if reason.stage is stage} for stage in RejectionStage}
    rows = [
        (STAGE_TEXTS[stage], str(len(names[stage])), str(sum(reason.stage is stage for reason in reasons)))
        for stage in RejectionStage
        if names[stage]
    ]
    evidence = {candidate["name"]: candidate["evidence"] or 0.0 for candidate in answer["candidates"]}
    named = {*answer["set"], *(effect["name"] for effect in answer["effects"])}
    strongest = sorted(evidence.keys() & last.keys() - named, key=lambda name: (-evidence[name], name))
    return [
        "## Rejected candidates",
        "",
        "`reasons` in gap.json lists them all.",
        "",
        *markdown_table(("stage", "effects", "reasons"), rows),
        *(f"- {candidate_text(last[name])}" for name in strongest[:MAX_REJECTED]),
        *([""] if strongest else []),
    ]


def _drive_lines(answer: Mapping[str, Any]) -> list[str]:
    """The drives of the bench (`--drive`)."""
    rows = [(str(drive["round"]), drive["words"], f"`{drive['log']}`") for drive in answer.get("drives", [])]
    if not rows:
        return []
    first = "The first answer, from the logs alone, is kept in gap-1.md and gap-1.json."
    return ["## What the bench drove", "", *markdown_table(("round", "manoeuvre", "log"), rows), first, ""]


def _effect_lines(answer: Mapping[str, Any]) -> list[str]:
    if not answer["effects"]:
        return []
    is_verified = bool(answer.get("proof_blocks"))
    rows = [
        (
            effect["name"],
            describe_parameters(effect),
            _format_number(effect["evidence"]),
            _describe_error_reduction(effect, is_verified),
        )
        for effect in answer["effects"]
    ]
    head = ("effect", "value (95 %)", "evidence, nats", "error reduction of its own signal")
    return ["## What is missing", "", *markdown_table(head, rows)]


def _describe_error_reduction(effect: Mapping[str, Any], is_verified: bool) -> str:
    """On the blocks that the effect was fitted on, and on the holdout blocks."""
    judged, holdout = effect.get("shrink"), effect.get("unseen_shrink")
    if judged is None:
        return ""
    text = f"{100.0 * judged:.0f} %"
    return text if holdout is None or not is_verified else f"{text}; {100.0 * holdout:.0f} % on the holdout blocks"


def _holdout_lines(answer: Mapping[str, Any]) -> list[str]:
    if not answer["signals"]:
        return []
    columns = {"before": "original", "recalibrated": "recalibration only", "after": "repaired"}
    if any(gap.get("unforetold") is not None for gap in answer["signals"].values()):
        columns["unforetold"] = "of that, unpredictable"
    columns["floor"] = "floor"
    rows = [
        (name, *(_format_number(gap.get(key)) for key in columns), gap["unit"])
        for name, gap in answer["signals"].items()
    ]
    gap_share, block_s = answer.get("explained_frac"), answer.get("block_s")
    length = f" of {block_s:.3g} s" if block_s else ""
    lines = [
        "## Verification",
        "",
        f"Free runs of the whole vehicle over {answer.get('proof_blocks')} holdout blocks{length}, which no fit and no "
        "selection used: recorded commands in, no correction within a block. Errors are root mean squares.",
    ]
    if needs_further_drive(answer):
        lines.append("They do not show what is missing: another drive has to confirm the repair.")
    elif gap_share:
        lines.append(f"The repair closes {format_percent(gap_share)} of what recalibration leaves above the floor.")
    if answer.get("explicable_frac"):
        lines.append(f"Of the part that these logs allow to predict: {format_percent(answer['explicable_frac'])}.")
    lines += _origin_lines(answer) + _chance_lines(answer)
    return [*lines, "", *markdown_table(("signal", *columns.values(), "unit"), rows), *_closed_loop_lines(answer)]


def _origin_lines(answer: Mapping[str, Any]) -> list[str]:
    """Parameters of the models that do not come from the logs in question."""
    lines = []
    if answer.get("from_own_logs"):
        lines.append(
            "Both models start from the parameters that the calibration logs gave (`own_numbers` in card.json); "
            "the original is the model as it lies in its folder."
        )
    if answer.get("does_not_pay"):
        groups = join_names([GROUP_NAMES[group] for group in answer["does_not_pay"]])
        lines.append(f"Recalibration leaves {groups} unchanged: moving them does not improve the selection blocks.")
    return lines


def _chance_lines(answer: Mapping[str, Any]) -> list[str]:
    """Signals whose error grows in a model that is kept, but not beyond chance."""
    grown = answer.get("grown") if answer.get("model") else None
    if not grown:
        return []
    signals = ", ".join(f"{name} by {100.0 * share:.0f} %" for name, share in grown.items())
    return [f"Larger errors than the original, within what these blocks differ by chance: {signals}."]


def _closed_loop_lines(answer: Mapping[str, Any]) -> list[str]:
    closed_loop = answer.get("closed_loop")
    if not closed_loop:
        reason = answer.get("closed_loop_words")
        return [f"Closed loop: {reason}.", ""] if reason else []
    rows = [
        (name, *(_format_number(signal[key]) for key in ("before", "recalibrated", "after")), signal["unit"])
        for name, signal in closed_loop["signals"].items()
    ]
    text = f"Closed loop, the same controller on the same road: {closed_loop['words']}."
    return [text, "", *markdown_table(("signal", "original", "recalibration only", "repaired", "unit"), rows)]


def _older_log_lines(answer: Mapping[str, Any]) -> list[str]:
    lines = []
    for log in answer["older"]:
        rows = [
            (
                name,
                _format_number(signal["before"]),
                _format_number(signal["after"]),
                signal["unit"],
                "worse" if name in log["worse"] else "",
            )
            for name, signal in log["signals"].items()
        ]
        table = markdown_table(("signal", "original", "repaired", "unit", ""), rows)
        lines += [f"## Older log {log['name']}", "", *(table if log.get("blocks", 1) else [NOT_DRIVABLE, ""])]
    return lines


def _figure_lines(path: Path, answer: Mapping[str, Any]) -> list[str]:
    lines = []
    for figure in map(Path, answer["figures"]):
        relative = figure.relative_to(path.parent).as_posix()
        lines += [f"## {CAPTIONS[figure.stem]}", "", f"![{CAPTIONS[figure.stem]}]({relative})", ""]
    return lines


def _link_lines(answer: Mapping[str, Any]) -> list[str]:
    if not answer["links"]:
        return []
    rows = [
        (
            link["link"],
            link["signal"],
            _format_number(link["rms"]),
            _format_number(link["noise"]),
            link["unit"],
            f"{100.0 * link['share']:.1f} %",
            "broken" if link["broken"] else "",
        )
        for link in answer["links"]
    ]
    head = ("link", "signal", "misfit (RMS)", "of that, noise", "unit", "predictable, share of the signal", "")
    lost = [f"- {link}: {reason}" for link, reason in answer["lost"].items()]
    return ["## Misfit of each link", "", *markdown_table(head, rows), *lost, *([""] if lost else [])]


def _candidate_lines(answer: Mapping[str, Any]) -> list[str]:
    best = sorted(answer["candidates"], key=lambda candidate: -(candidate["evidence"] or 0.0))[:MAX_CANDIDATES]
    if not best:
        return []
    rows = [
        (
            candidate["name"],
            _format_number(candidate["evidence"]),
            _format_number(candidate["held_out"][0]),
            candidate["signal"],
            f"{100.0 * (candidate['shrink'][0] or 0.0):.0f} %",
            "yes" if candidate["counts"] else "",
        )
        for candidate in best
    ]
    head = ("candidate", "evidence, nats", "cross-validated, nats", "signal", "error reduction", "accepted")
    count = len(answer["candidates"])
    return [f"## The {len(best)} best of {count} candidates", "", *markdown_table(head, rows)]


def _change_lines(answer: Mapping[str, Any]) -> list[str]:
    if not answer.get("changes"):
        return []
    rows = [
        (f"`{change['key']}`", _format_number(change["before"]), _format_number(change["after"]))
        for change in answer["changes"]
    ]
    return ["## Changes of the model", "", *markdown_table(("key", "before", "after"), rows)]


def _unobservable_lines(answer: Mapping[str, Any]) -> list[str]:
    lines = [
        f"- {name}: {', '.join(excitation['lacks'])}"
        for name, excitation in answer["excitation"].items()
        if not excitation["enough"]
    ]
    lines += [f"- {name}: {reason}" for name, reason in answer["not_suspected"].items()]
    return ["## What these logs cannot show", "", *lines, ""] if lines else []


def _format_number(value: float | None) -> str:
    return "" if value is None else f"{value:.4g}"
