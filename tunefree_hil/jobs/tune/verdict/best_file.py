"""best.toml: the winner of a study, with its verification in it. A rejected one cannot be pasted by accident."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.config.convert import read_toml
from tunefree_hil.config.dump import to_toml
from tunefree_hil.grade.requirements.judgement import violation_text
from tunefree_hil.grade.requirements.verdict import DecidedGains, GainsVerdict
from tunefree_hil.jobs.run_folder import RunFolder, write_text
from tunefree_hil.jobs.tune.verdict.text import manual_text

FILE = "best.toml"
PARAMETERS, REJECTED_PARAMETERS = "parameters", "rejected_parameters"  # tables
NOT_VERIFIED = "not verified"  # the value of "verdict" until `verify` has run
WRITTEN_ANEW = ("verdict", "verification", PARAMETERS, REJECTED_PARAMETERS, "controller")  # by every verdict


class DrivenOn(NamedTuple):
    """What a verdict is of: the plant, the roads, and the seed of made roads (else that of the bench file)."""

    model: str
    roads: list[str]
    seed: int
    is_verified: bool = True


def read_best(run: RunFolder) -> dict[str, Any]:
    """Read best.toml of a tune; "parameters" are those of the winner, rejected or not.

    Raises InputError where the study is not finished, or the file was changed.
    """
    path = run.path / FILE
    if not path.is_file():
        hint = "run the same tune command again"
        raise InputError("has no best.toml: the study is not finished", file=str(run.path), hint=hint)
    best = read_toml(path)
    if REJECTED_PARAMETERS in best:
        best = {**best, PARAMETERS: best[REJECTED_PARAMETERS]}
    if not isinstance(best.get(PARAMETERS), dict):
        hint = "run the same tune command with --resume RUN to write it again"
        raise InputError("is missing", code="bad_toml", file=str(path), key=PARAMETERS, hint=hint)
    return best


def write_best(
    run: RunFolder,
    winner: Mapping[str, Any],
    decided: DecidedGains,
    driven: DrivenOn,
    vectors: Mapping[str, Mapping[str, float]],
    oscillation: str = "",
) -> None:
    """Write best.toml, atomically.

    Args:
        run: Run folder of the tune.
        winner: What is known of it without a verdict; "parameters" are its complete vector.
        decided: The verdict, which is written where it was verified or is REJECTED.
        driven: On what.
        vectors: Complete vectors of the manual sets, one of which is offered instead of a rejected winner.
        oscillation: What oscillates, as text; '' for nothing.
    """
    is_rejected = decided.verdict is GainsVerdict.REJECTED
    word = decided.verdict.value if driven.is_verified or is_rejected else NOT_VERIFIED
    data = {key: value for key, value in winner.items() if key not in WRITTEN_ANEW} | {"verdict": word}
    data[REJECTED_PARAMETERS if is_rejected else PARAMETERS] = winner[PARAMETERS]
    if is_rejected and decided.best_manual.judgement.is_met:
        data["controller"] = {PARAMETERS: dict(vectors[decided.manual])}
    if driven.is_verified or is_rejected:
        judged = decided.tuned.judgement.as_data()
        data["verification"] = {**driven._asdict(), **judged, "oscillation": oscillation}
    # simple values first: a table would swallow them
    ordered = dict(sorted(data.items(), key=lambda item: isinstance(item[1], dict)))
    write_text(run.path / FILE, "".join(f"# {line}\n" for line in _head(decided, word)) + to_toml(ordered))


def _head(decided: DecidedGains, word: str) -> list[str]:
    """Comment lines."""
    paste = "[parameters] is complete: paste it into [controller.parameters] of a bench file."
    if decided.verdict is GainsVerdict.REJECTED:
        offered = f"Nothing is offered instead: {manual_text(decided)}."
        if decided.best_manual.judgement.is_met:
            offered = f"[controller.parameters] is the manual set {decided.manual}, which meets the requirements."
        return [f"{word}: {violation_text(decided.tuned.judgement)}: do not paste", offered]
    if word == GainsVerdict.NO_GAIN.value:
        return [f"{word}: the manual set {decided.manual} meets the requirements and is as good.", paste]
    return [f"The winner of a study, {word}. {paste}"]
