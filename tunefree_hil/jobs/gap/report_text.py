"""Texts of `gap`: the answer in one sentence, remarks to it, and the commands that come next."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from tunefree_hil.gap.selection.reasons import Criterion, Reason, VerdictKind
from tunefree_hil.jobs.command_text import changed_options, option_arguments, shell_command
from tunefree_hil.jobs.gap.acceptance import NAMED, has_no_gain, is_within_baseline, needs_further_drive
from tunefree_hil.jobs.learn.report_text import find_benches

if TYPE_CHECKING:
    from tunefree_hil.config.schema import VehicleSpec
    from tunefree_hil.jobs.gap.options import GapDriveOptions, GapOptions

SET, NONE_MISSING = VerdictKind.SET.value, VerdictKind.NONE_MISSING.value
NONE_OF_THESE, CANNOT_TEST = VerdictKind.NONE_OF_THESE.value, VerdictKind.CANNOT_TEST.value
SHARE_KEYS = ("value", "low", "high")
NOT_DRIVABLE = (
    "No block of this log can be simulated with commands that were obeyed: the repair cannot be judged on it."
)
MAX_SHOWN_SHARE = 10.0  # larger shares of a signal are written as this
MAX_SHOWN_PARAMETERS = 3  # parameters that are listed


def describe_answer(answer: Mapping[str, Any]) -> str:
    """The answer in one sentence: what is missing, its value with interval and unit, the closed share of the gap."""
    verdict = answer["verdict"]
    if verdict in NAMED:
        return _describe_effects(answer)
    if verdict == SET:
        text = f"{_describe_set(answer)}, and these logs cannot tell which"
        return f"{text}; to separate them, drive {answer['separate_by']}" if answer["separate_by"] else text
    if verdict == NONE_MISSING:
        return _describe_none_missing(answer)
    reasons = "; ".join(answer["words"])
    if verdict == NONE_OF_THESE:
        if answer.get("missed_in_proof"):
            return f"something is missing that the search could not see: {answer['words'][0]}"
        if is_within_baseline(answer):
            return (
                f"nothing exceeds what this model misses of its calibration logs, which hides smaller gaps: {reasons}"
            )
        return f"something is missing that is not in the catalogue: {reasons}{_describe_location(answer)}"
    if verdict == CANNOT_TEST:
        return f"these logs cannot tell: {reasons}"
    return f"simulation and measurement differ here: {answer['where']['card']}"


def _describe_effects(answer: Mapping[str, Any]) -> str:
    effects = [f"{effect['name']} ({describe_parameters(effect)})" for effect in answer["effects"]]
    text = f"{join_names(effects)} {'is' if len(effects) == 1 else 'are'} missing"
    worse, closed = answer.get("worse") or [], answer.get("explained_frac")
    if needs_further_drive(answer):
        return f"{text}; the holdout blocks do not show it, and another drive has to confirm the model"
    if has_no_gain(answer) and not worse:
        return f"{text}; no model is written, as it closes nothing of the gap in the holdout blocks"
    if closed:
        text += f"; it closes {format_percent(closed)} of the gap that recalibration leaves"
    if worse:
        text += f"; no model is written, as it would make other signals worse, above all {worse[0]}"
    return text


def _describe_none_missing(answer: Mapping[str, Any]) -> str:
    """With what recalibration moved, what `calibrate` would gain, and which effects these logs cannot show."""
    not_excited = [name for name, excitation in answer["excitation"].items() if not excitation["enough"]]
    invisible = list(dict.fromkeys([*answer["untold"], *not_excited]))
    text = "nothing is missing beyond noise and recalibration"
    text += _describe_moved_parameters(answer) + _describe_calibration_gain(answer)
    text += f"; {answer['words'][0]}" if answer.get("taken_back") else ""
    return f"{text}; these logs could not have shown {_join_first(invisible)}" if invisible else text


def _describe_set(answer: Mapping[str, Any]) -> str:
    """'one of a and b is missing'; of several effects at once also what may take the place of one of them."""
    together = answer.get("together") or []
    alternatives = [name for name in answer["set"] if name not in together]
    if not together:
        return f"one of {join_names(alternatives)} is missing"
    instead = f"one of {join_names(alternatives)}" if len(alternatives) > 1 else alternatives[0]
    return f"{join_names(together)} are missing together, or {instead} in place of one of them"


def describe_rejection(names: Sequence[str], reason: Reason, gap_share: Mapping[str, float] | None) -> str:
    """Why effects that the search found are not named: what the repair closes of the gap in the holdout blocks."""
    text = f"{join_names(names)} {'fits' if len(names) == 1 else 'fit'} best, but"
    if gap_share is None:
        return f"{text} the gap could not be measured in the holdout blocks"
    if reason.criterion is Criterion.GAP_NOT_CLOSED:
        return f"{text} the repair closes nothing of the gap in the holdout blocks"
    closed = f"the repair closes {format_percent(gap_share)} of the gap in the holdout blocks"
    left = "which leaves a third or more" if reason.criterion is Criterion.GAP_LEFT else "which may be none"
    return f"{text} {closed}, {left}"


def describe_holdout_misfit(missed: Mapping[str, float]) -> str:
    """What only the holdout blocks miss.

    Args:
        missed: Misfit by signal as a share of the signal, the worst first.
    """
    shown = list(missed.items())[:MAX_SHOWN_PARAMETERS]
    signals = join_names([f"{name} by {min(share, MAX_SHOWN_SHARE):.0%} of the signal" for name, share in shown])
    return f"the holdout blocks miss {signals}, the other blocks no more than a calibrated model may"


def describe_parameters(effect: Mapping[str, Any]) -> str:
    """'tau_s 0.120 s (0.118 to 0.122)', one parameter after the other."""
    return ", ".join(f"{key} {_describe_parameter(parameter)}" for key, parameter in effect["params"].items())


def _describe_parameter(parameter: Mapping[str, Any]) -> str:
    unit = "" if parameter["unit"] in ("", "1") else f" {parameter['unit']}"
    value = f"{_format_value(parameter['value'], parameter)}{unit}"
    if parameter["low"] is None and parameter["high"] is None:
        return f"{value} (interval unknown)"
    ends = [parameter[end] for end in ("low", "high")]
    low, high = ("?" if end is None else _format_value(end, parameter) for end in ends)
    return f"{value} ({low} to {high})"


def _format_value(value: float, parameter: Mapping[str, Any]) -> str:
    """With the decimals of half the interval; three digits where there is no interval."""
    low, high = parameter["low"], parameter["high"]
    if low is None or high is None or not high > low:
        return f"{value:.3g}"
    decimals = max(0, min(8, math.ceil(-math.log10(0.5 * (high - low)))))
    return f"{round(value, decimals) + 0.0:.{decimals}f}"  # no -0


def format_percent(share: Mapping[str, float | None]) -> str:
    """'97 % (94 to 99)'."""
    value, low, high = (None if share[key] is None else round(100.0 * (share[key] or 0.0)) for key in SHARE_KEYS)
    return f"{value or 0} %" + ("" if low is None or high is None else f" ({low} to {high})")


def join_names(names: Sequence[str]) -> str:
    """'a, b and c'."""
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last


def _join_first(names: Sequence[str], most: int = 4) -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def _describe_moved_parameters(answer: Mapping[str, Any]) -> str:
    """Parameters that recalibration moved by more than a calibrated model may be off."""
    moved = answer.get("moved") or []
    more = f" and {len(moved) - 1} more" if len(moved) > 1 else ""
    return f"; but {moved[0]}{more}, which may also be a missing effect" if moved else ""


def _describe_calibration_gain(answer: Mapping[str, Any]) -> str:
    """What `calibrate` would gain, for the signal that gains most."""
    gains = answer.get("recalibration")
    if not gains:
        return ""
    name, gain = min(gains.items(), key=lambda item: item[1]["recalibrated"] / item[1]["before"])
    ends = f"from {gain['before']:.3g} to {gain['recalibrated']:.3g} {answer['signals'][name]['unit']}"
    return f"; `calibrate` on these logs would reduce the error of {name} {ends}"


def _describe_location(answer: Mapping[str, Any]) -> str:
    card = answer["where"]["card"]
    return f" (where: {card})" if card else ""


def list_remarks(answer: Mapping[str, Any]) -> list[str]:
    """What the sentence leaves out: why it is a set, what the drive lacked, what recalibration moved."""
    verdict, moved = answer["verdict"], answer.get("moved") or []
    remarks = [] if verdict in (NONE_OF_THESE, CANNOT_TEST, NONE_MISSING) else answer["words"]
    if len(moved) > MAX_SHOWN_PARAMETERS:
        count = len(moved) - MAX_SHOWN_PARAMETERS
        more = f"recalibration moves {count} further parameters about as far (`moved` in gap.json)"
        moved = [*moved[:MAX_SHOWN_PARAMETERS], more]
    is_in_sentence = verdict == NONE_MISSING and len(moved) == 1
    return [*remarks, *([] if is_in_sentence else moved)]


def build_command(
    options: GapOptions,
    until: str = "",
    more_logs: Sequence[str] = (),
    out: str = "",
    drive: GapDriveOptions | None = None,
) -> str:
    """The same command again, with changed options where they are given."""
    repeated = options._replace(until=until or options.until, out=out or options.out)
    command = shell_command("gap", *options.logs, *more_logs, **changed_options(repeated, skip=["logs"]))
    if drive is None:
        return command
    return f"{command} {shlex.join(option_arguments(drive=True, **changed_options(drive)))}"


def suggest_commands(
    options: GapOptions, answer: Mapping[str, Any], vehicle: VehicleSpec, drive: GapDriveOptions | None = None
) -> list[str]:
    """The commands to go on with.

    Args:
        options: Options of this command.
        answer: Content of gap.json.
        vehicle: Vehicle of the logs.
        drive: Options of `--drive`, whose bench is of this vehicle; None without it.
    """
    verdict, logs, folder = answer["verdict"], options.logs, options.vehicle
    if verdict is None:
        return [build_command(options, "verify", drive=drive)]
    is_open = has_no_gain(answer) or needs_further_drive(answer) or bool(answer.get("missed_in_proof"))
    if verdict in (SET, CANNOT_TEST) or is_open:
        return [build_command(options, more_logs=["NEXT.log"], out=f"{options.out}-2", drive=drive)]
    if verdict == NONE_OF_THESE:
        return [shell_command("learn", *logs, vehicle=folder, out=f"{options.out}-hybrid")]
    if verdict == NONE_MISSING and answer.get("recalibration"):
        return [shell_command("calibrate", *logs, vehicle=folder, out=f"{options.model}-recalibrated")]
    if verdict in NAMED and answer["until"] != "verify":
        return [build_command(options, "verify", drive=drive)]
    model = answer["model"] or options.model
    bench = next(iter(find_benches(vehicle)), "BENCH") if drive is None else str(drive.bench)
    return [shell_command("drive", bench, model=model)]
