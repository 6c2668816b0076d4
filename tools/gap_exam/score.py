"""The table of an exam: truths of answered cases opened, answers marked, rows counted, with n and intervals."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Hashable, Sequence
from typing import Any, NamedTuple

import numpy as np

from tools.gap_exam import outcomes
from tools.gap_exam.driver import PERSON
from tools.gap_exam.files import Run, read_json
from tools.gap_exam.outcomes import OUTCOMES, Mark, mark, names_of
from tools.gap_exam.seal import open_truth
from tools.gap_exam.statistics import Figure, by_models, mean, quantile, share, share_by_models

# Rows in which logs of one model err together: it has their effect inside, or was learned. In the others logs of one
# vehicle share a calibration that has no part in what is hidden, and count one by one
SHARING = ("start_b", "start_c", "start_d")


class Marked(NamedTuple):
    """An answered case: its truth, its answer, its mark. run: whose folder it lies in, as models of two runs differ."""

    number: int
    truth: dict[str, Any]
    answer: dict[str, Any] | None
    mark: Mark
    run: str = ""


class Row(NamedTuple):
    """A row of the table: how many of each outcome, and figures with intervals (shares from 0 to 1).

    models: from how many models its logs start. whole: whether its intervals draw whole models.
    """

    name: str
    n: int
    outcomes: dict[str, int]
    figures: dict[str, Figure]
    models: int
    whole: bool = False


def marked(run: Run, numbers: Sequence[int]) -> list[Marked]:
    """Open and mark every case that has an answer."""
    found = []
    for number in numbers:
        if run.is_answered(number):
            truth = open_truth(run, number)
            path = run.answer(number) / "gap.json"
            answer = read_json(path) if path.is_file() else None
            seconds = read_json(run.answer(number) / "run.json")["seconds"]
            found.append(Marked(number, truth, answer, mark(truth, answer, seconds), str(run.folder)))
    return found


def detectable(one: Marked) -> bool:
    """What the oracle said before the answer."""
    return outcomes.detectable(one.truth)


def each_detectable(one: Marked) -> bool:
    """Whether each of two effects can be found beside the other; one may hide the other (a limit that is never met)."""
    return all(found["detectable"] for found in one.truth["each"].values())


def model_of(one: Marked) -> Hashable:
    """Which model a case starts from: its own where none is said."""
    name = one.truth.get("model") or one.truth.get("source")
    return (one.run, name or one.number)


class _Count:
    """Makes figures of some cases: every value is a case's own, and knows its model."""

    def __init__(self, cases: Sequence[Marked]) -> None:
        self.cases = cases
        self.models = [model_of(one) for one in cases]
        shares = len(set(self.models)) < len(cases)
        self.whole = shares and all(one.truth["row"] in SHARING for one in cases)

    def yes(self, said: Callable[[Marked], bool | Sequence[bool] | None]) -> Figure:
        """The share of yes among what is said."""
        values, models = self._values(said)
        hits = [bool(value) for value in values]
        return share_by_models(hits, models) if self.whole else share(sum(hits), len(hits))

    def mean(self, said: Callable[[Marked], float | None]) -> Figure:
        values, models = self._values(said)
        found = mean(values)
        return by_models(found, values, models, lambda some: float(some.mean())) if self.whole else found

    def quantile(self, said: Callable[[Marked], float | Sequence[float] | None], q: float) -> Figure:
        values, models = self._values(said)
        found = quantile(values, q)
        return by_models(found, values, models, lambda some: float(np.quantile(some, q))) if self.whole else found

    def _values(self, said: Callable[[Marked], Any]) -> tuple[list[float], list[Hashable]]:
        """What the cases say, one value, several or none, each with its model."""
        pairs = []
        for one, model in zip(self.cases, self.models, strict=True):
            values = said(one)
            several = values if isinstance(values, tuple) else (values,)
            pairs += [(float(value), model) for value in several if value is not None]
        return [value for value, _ in pairs], [model for _, model in pairs]


def row(name: str, cases: Sequence[Marked]) -> Row:
    """Outcomes and figures of some cases."""
    found = Counter(one.mark.outcome for one in cases)
    count = _Count(cases)
    figures = {
        **{outcome: count.yes(lambda one, outcome=outcome: one.mark.outcome == outcome) for outcome in OUTCOMES},
        "right_or_in_set": count.yes(lambda one: one.mark.outcome in ("right", "in_set")),
        "set_size": count.mean(lambda one: one.mark.set_size),
        "at_least_one": count.yes(lambda one: one.mark.at_least_one),
        "value_error_median": count.quantile(lambda one: one.mark.value_errors, 0.5),
        "value_error_90th": count.quantile(lambda one: one.mark.value_errors, 0.9),
        "covered": count.yes(lambda one: one.mark.covered),
        "right_link": count.yes(lambda one: one.mark.link),
        "gap_closed_median": count.quantile(lambda one: one.mark.closed, 0.5),
        "gap_closed_10th": count.quantile(lambda one: one.mark.closed, 0.1),
        "replay_down": count.quantile(lambda one: one.mark.replay_down, 0.5),
        "replay_worst": count.quantile(lambda one: one.mark.replay_worst, 1.0),
        "seconds": count.quantile(lambda one: one.mark.seconds, 0.5),
        "forced_right": count.yes(lambda one: one.mark.forced == "right" if one.mark.forced else None),
        "forced_wrong": count.yes(lambda one: one.mark.forced == "wrong" if one.mark.forced else None),
        "absorbed": count.yes(lambda one: bool((one.answer or {}).get("absorbed"))),
        "absorbed_true": count.yes(lambda one: one.mark.absorbed),
        "none_of_these": count.yes(lambda one: (one.answer or {}).get("verdict") == "none_of_these"),
    }
    said = {key: value for key, value in figures.items() if value.n}
    counts = {outcome: found.get(outcome, 0) for outcome in OUTCOMES}
    return Row(name, len(cases), counts, said, len(set(count.models)), count.whole)


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
