"""How long an exam takes: by row what a case takes, and what is left, from what this run took so far or another did.

A case's time is that of its question (made, judged by the oracle, written) and of its answer; a model's that of its
logs, its calibration, its training. Questions are made one at a time, answers are asked for two side by side.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping
from typing import Any, NamedTuple

from tools.gap_exam.files import Run, read_json
from tools.gap_exam.rows import Exam

# Seconds of a core that a case of a row takes, a model of a kind, before a run says so itself: read off a handful of
# cases each on a machine that did other work too, so rather too much
SECONDS: dict[str, float] = {
    "one": 40.0, "free": 35.0, "outside": 40.0, "two_other": 55.0, "two_same": 55.0, "start_b": 40.0, "start_c": 130.0,
    "start_d": 130.0, "semi": 35.0, "semi_free": 35.0, "limits": 32.0, "physics": 25.0, "hybrid": 320.0,
}  # fmt: skip
SIDE_BY_SIDE = 2


class Cost(NamedTuple):
    """A row of cases, or a kind of models: how many in all and left, seconds each, and whether this run measured it."""

    name: str
    count: int
    left: int
    seconds: float
    measured: bool

    @property
    def hours(self) -> float:
        """All of it, by itself on the machine."""
        return self.count * self.seconds / 3600.0 / SIDE_BY_SIDE

    @property
    def hours_left(self) -> float:
        """What is not done yet."""
        return self.left * self.seconds / 3600.0 / SIDE_BY_SIDE


def costs(exam: Exam, run: Run | None = None) -> list[Cost]:
    """By row, then by kind of model. run: whose answers say what a case takes; where they say nothing SECONDS do."""
    took, done = _took(exam, run)
    some = Counter(case.row for case in exam.cases) + Counter(model.kind for model in exam.models.values())
    found = []
    for name, count in sorted(some.items(), key=lambda one: list(SECONDS).index(one[0])):
        mine = took.get(name, [])
        each = sum(mine) / len(mine) if mine else SECONDS[name]
        found.append(Cost(name, count, count - done[name], each, bool(mine)))
    return found


def _took(exam: Exam, run: Run | None) -> tuple[Mapping[str, list[float]], Counter[str]]:
    """(seconds of what is done, by row and kind; how many of each are done)."""
    took: dict[str, list[float]] = defaultdict(list)
    done: Counter[str] = Counter()
    if run is None:
        return took, done
    for case in exam.cases:
        if run.is_answered(case.number):
            said: dict[str, Any] = read_json(run.answer(case.number) / "run.json")
            done[case.row] += 1
            took[case.row].append(said["seconds"] + said.get("made_s", 0.0))
    for name, model in exam.models.items():
        done[model.kind] += (run.model(name) / "model.toml").is_file()
        if run.model_time(name).is_file():
            took[model.kind].append(read_json(run.model_time(name))["seconds"])
    return took, done


def words(some: list[Cost]) -> str:
    """The table, for people; the last line sums up."""
    lines = [f"{'':<12}{'cases':>7}{'left':>7}{'s each':>9}{'hours':>8}{'left':>7}"]
    lines += [
        f"{one.name:<12}{one.count:>7}{one.left:>7}{one.seconds:>8.0f}{'' if one.measured else '*':<1}"
        f"{one.hours:>8.2f}{one.hours_left:>7.2f}"
        for one in some
    ]
    total, left = sum(one.hours for one in some), sum(one.hours_left for one in some)
    lines.append(f"{total:.1f} h in all on two quiet cores, {left:.1f} h left")
    if not all(one.measured for one in some):
        lines.append("* not measured in this run")
    return "\n".join(lines)
