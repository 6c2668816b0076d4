"""The table of an exam: truths of answered cases opened, answers marked, rows counted, with n and intervals."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from tools.gap_exam.driver import PERSON
from tools.gap_exam.files import Run, read_json
from tools.gap_exam.outcomes import OUTCOMES, Mark, mark, names_of
from tools.gap_exam.seal import open_truth
from tools.gap_exam.statistics import Figure, mean, quantile, share


class Marked(NamedTuple):
    """An answered case: its truth, its answer, its mark."""

    number: int
    truth: dict[str, Any]
    answer: dict[str, Any] | None
    mark: Mark


class Row(NamedTuple):
    """A row of the table: how many of each outcome, and figures with intervals (shares from 0 to 1)."""

    name: str
    n: int
    outcomes: dict[str, int]
    figures: dict[str, Figure]


def marked(run: Run, numbers: Sequence[int]) -> list[Marked]:
    """Open and mark every case that has an answer."""
    found = []
    for number in numbers:
        if run.is_answered(number):
            truth = open_truth(run, number)
            path = run.answer(number) / "gap.json"
            answer = read_json(path) if path.is_file() else None
            seconds = read_json(run.answer(number) / "run.json")["seconds"]
            found.append(Marked(number, truth, answer, mark(truth, answer, seconds)))
    return found


def detectable(one: Marked) -> bool:
    """What the oracle said before the answer; recordings have no oracle, and all of theirs count."""
    return one.truth.get("oracle") is None or bool(one.truth["oracle"]["detectable"])


def each_detectable(one: Marked) -> bool:
    """Whether each of two effects can be found beside the other; one may hide the other (a limit that is never met)."""
    return all(found["detectable"] for found in one.truth["each"].values())


def row(name: str, cases: Sequence[Marked]) -> Row:
    """Outcomes and figures of some cases."""
    count = Counter(one.mark.outcome for one in cases)
    outcomes = {outcome: count.get(outcome, 0) for outcome in OUTCOMES}
    n, marks = len(cases), [one.mark for one in cases]
    figures = {
        "right": share(outcomes["right"], n),
        "right_or_in_set": share(outcomes["right"] + outcomes["in_set"], n),
        "wrong": share(outcomes["wrong"], n),
        "silent": share(outcomes["silent"], n),
        "set_size": mean([float(one.set_size) for one in marks if one.set_size is not None]),
        "at_least_one": _yes([one.at_least_one for one in marks]),
        "value_error_median": quantile([error for one in marks for error in one.value_errors], 0.5),
        "value_error_90th": quantile([error for one in marks for error in one.value_errors], 0.9),
        "covered": _yes([yes for one in marks for yes in one.covered]),
        "right_link": _yes([one.link for one in marks]),
        "gap_closed_median": quantile([one.closed for one in marks if one.closed is not None], 0.5),
        "gap_closed_10th": quantile([one.closed for one in marks if one.closed is not None], 0.1),
        "replay_down": quantile([one.replay_down for one in marks if one.replay_down is not None], 0.5),
        "replay_worst": quantile([one.replay_worst for one in marks if one.replay_worst is not None], 1.0),
        "seconds": quantile([one.seconds for one in marks if one.seconds is not None], 0.5),
        "forced_right": _yes([one.forced == "right" for one in marks if one.forced is not None]),
        "forced_wrong": _yes([one.forced == "wrong" for one in marks if one.forced is not None]),
        "absorbed": _yes([bool((one.answer or {}).get("absorbed")) for one in cases]),
        "none_of_these": _yes([(one.answer or {}).get("verdict") == "none_of_these" for one in cases]),
    }
    return Row(name, n, outcomes, {key: value for key, value in figures.items() if value.n})


def _yes(values: Sequence[bool | None]) -> Figure:
    said = [value for value in values if value is not None]
    return share(sum(said), len(said))


Filter = Callable[[Marked], bool]


def _of(*rows: str) -> Filter:
    return lambda one: one.truth["row"] in rows


def table(cases: Sequence[Marked]) -> list[Row]:
    """All rows that have at least one case, in the order of the issue."""
    named: list[tuple[str, Filter]] = [
        ("one effect, detectable", lambda one: _of("one")(one) and detectable(one)),
        ("one effect, not detectable", lambda one: _of("one")(one) and not detectable(one)),
        ("effect-free", _of("free")),
        ("effect-free, no background mismatch", lambda one: _of("free")(one) and not one.truth["mismatch"]),
        ("effect-free, background mismatch", lambda one: _of("free")(one) and bool(one.truth["mismatch"])),
        ("outside the catalogue", _of("outside")),
        ("outside the catalogue, detectable", lambda one: _of("outside")(one) and detectable(one)),
        ("two effects, other subsystems", _of("two_other")),
        ("two effects, same subsystem", _of("two_same")),
        ("two effects, other subsystems, each detectable", lambda one: _of("two_other")(one) and each_detectable(one)),
        ("two effects, same subsystem, each detectable", lambda one: _of("two_same")(one) and each_detectable(one)),
        *((f"start ({key}), detectable", lambda one, key=key: _of(f"start_{key}")(one) and detectable(one))
          for key in "bcd"),
        ("start (b), taken in by the model", lambda one: _of("start_b")(one) and not detectable(one)),
        ("start (c), not detectable", lambda one: _of("start_c")(one) and not detectable(one)),
        ("start (d), taken in by the model", lambda one: _of("start_d")(one) and not detectable(one)),
        *((f"one effect, {kind} drive", lambda one, kind=kind: _one(one) and one.truth["kind"] == kind)
          for kind in ("ordinary", "excited")),
        ("one effect, a person drives", lambda one: _one(one) and one.truth["who"] == PERSON),
        ("one effect, a controller drives", lambda one: _one(one) and one.truth["who"] != PERSON),
        *((f"one effect, background mismatch {100 * value:.0f} %",
           lambda one, value=value: _one(one) and one.truth["mismatch"] == value) for value in (0.0, 0.02, 0.05)),
        ("semi-real", _of("semi")),
        ("semi-real, untouched originals", _of("semi_free")),
    ]  # fmt: skip
    rows = [row(name, [one for one in cases if wanted(one)]) for name, wanted in named]
    return [one for one in rows if one.n]


def _one(one: Marked) -> bool:
    return one.truth["row"] == "one" and detectable(one)


def false_names(cases: Sequence[Marked]) -> list[dict[str, Any]]:
    """Every wrong name and every false alarm, to be looked at one by one."""
    found = []
    for one in cases:
        if one.mark.outcome == "wrong":
            answer = one.answer or {}
            names = {"effects": names_of(answer), "set": list(answer.get("set", []))}
            truth = {"row": one.truth["row"], "truth": one.truth["effects"], "kind": one.truth["kind"]}
            found.append({"number": one.number, "verdict": answer.get("verdict"), **truth, **names})
    return found
