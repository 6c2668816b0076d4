"""An exam as it is asked for: begun or gone on with, and counted however far it is.

What an exam is, is fixed when it is begun: its domain, all of its cases, the state of these files. Which rows and
parts of it are asked, how many and for how long, is each call's own.
"""

from __future__ import annotations

import subprocess
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from tools.gap_exam.beside import row_of
from tools.gap_exam.cases import Case
from tools.gap_exam.files import Run, read_json
from tools.gap_exam.limits import Limit, limits
from tools.gap_exam.order import in_order, part_of
from tools.gap_exam.prepare import Frozen, begin, is_frozen
from tools.gap_exam.program import Program
from tools.gap_exam.recordings import make_ready
from tools.gap_exam.report import write_report
from tools.gap_exam.rows import ROWS, Exam, exam_of, sample_of
from tools.gap_exam.runner import Examiner
from tools.gap_exam.score import Marked, Row, false_names, marked, table
from tools.gap_exam.seeds import EXAM, Domain, domain_of

ROOT = Path(__file__).resolve().parents[2]


class Wish(NamedTuple):
    """What to ask now. domain: None that of the run, else of the commit. rows: none all. part: 'K/N'.

    logs: no more than the first so many of the chosen ones, 0 all; hours: 0 without end. recordings: for the row
    `semi`, which is left out where there are none.
    """

    run: Path
    domain: Domain | None = None
    sample: bool = False
    rows: tuple[str, ...] = ()
    part: str = "1/1"
    logs: int = 0
    hours: float = 0.0
    recordings: Path | None = None
    parallel: int = 2
    unfrozen: bool = False
    keep: bool = False
    program: Program = Program()


def conduct(wish: Wish) -> Exam:
    """Ask what is wished for and not answered yet; the exam. Raises Frozen, NoRecording, ValueError.

    Where all of it is answered nothing is asked, and so the checkout need not be the exam's.
    """
    run, exam = Run(wish.run), exam_for(wish)
    cases = chosen(exam, wish)
    if run.exam.is_file() and all(run.is_answered(case.number) for case in cases):
        return exam  # to be counted alone, which any checkout may do
    frozen = is_frozen(exam, ROOT)
    if exam.domain.kind == EXAM and not (frozen or wish.unfrozen):
        raise Frozen(
            f"this checkout is not {exam.domain.name} as committed, and some of it has no answer; score counts what "
            "is, --unfrozen asks all the same, said so"
        )
    begin(run, exam, frozen=frozen, sample=wish.sample, program=wish.program)
    if wish.recordings is not None and any(case.source for case in cases):
        make_ready(run, wish.recordings)
    Examiner(run, exam, wish.program, keep=wish.keep).go(cases, wish.parallel, wish.hours)
    return exam


def exam_for(wish: Wish) -> Exam:
    """The exam that a folder holds already, else the one that is asked for."""
    said = read_json(Run(wish.run).exam) if Run(wish.run).exam.is_file() else {}
    if said.get("sample", wish.sample) != wish.sample:
        held = "a sample" if said["sample"] else "a whole exam"
        raise Frozen(f"{wish.run} holds {held}; another exam needs another folder")
    domain = wish.domain or (domain_of(said["domain"]) if said else Domain(EXAM, head()))
    return sample_of(domain) if wish.sample else exam_of(domain)


def head() -> str:
    """The commit that is checked out, as 40 hex digits."""
    words = ["git", "-C", str(ROOT), "rev-parse", "HEAD"]
    return subprocess.run(words, capture_output=True, text=True, check=False).stdout.strip()


def chosen(exam: Exam, wish: Wish) -> list[Case]:
    """The cases that are wished for, in the order in which they are asked."""
    unknown = set(wish.rows) - set(ROWS)
    if unknown:
        raise ValueError(f"no row {', '.join(sorted(unknown))}; there are {', '.join(ROWS)}")
    number, _, parts = wish.part.partition("/")
    if not (number.isdigit() and parts.isdigit() and 1 <= int(number) <= int(parts)):
        raise ValueError(f"a part is K/N, 1/4 to 4/4, not {wish.part!r}")
    if "semi" in wish.rows and wish.recordings is None:
        raise ValueError("the row `semi` needs recordings of real cars: name their folder")
    cases = [
        case
        for case in in_order(exam)
        if (not wish.rows or case.row.startswith(wish.rows))
        and part_of(case, int(parts)) == int(number) - 1
        and not (case.source and wish.recordings is None)
    ]
    return cases[: wish.logs or None]


def askable(run: Run, exam: Exam) -> Exam:
    """An exam without the cases of recordings, where a run was never given any: those are not left to be asked."""
    if (run.folder / "recordings").is_dir():
        return exam
    return exam._replace(cases=tuple(case for case in exam.cases if not case.source))


def standing(run: Run) -> dict[str, Any]:
    """How far a run is: what was frozen, answered and asked for in all, by row too where all of it can be told."""
    said = read_json(run.exam)
    domain = domain_of(said["domain"])
    exam = sample_of(domain) if said["sample"] else exam_of(domain)
    of = Counter(case.row for case in exam.cases)
    done = Counter(case.row for case in exam.cases if run.is_answered(case.number))
    return {
        **{key: said[key] for key in ("domain", "frozen", "truths", "source")},
        "done": f"{done.total()} of {of.total()} done",
        "whole": done.total() == of.total(),
        "rows_done": {row: f"{done[row]} of {count}" for row, count in sorted(of.items())},
    }


class Counted(NamedTuple):
    """All of what is answered. exams: how far each run is; cases: opened and marked, with their run."""

    exams: list[dict[str, Any]]
    cases: list[tuple[Run, Marked]]
    rows: list[Row]
    limits: list[Limit]
    wrong: list[dict[str, Any]]
    name: str


def count(runs: Sequence[Run]) -> Counted:
    """Open what is answered in these runs, and write table.md, table.json and the pictures into the first."""
    exams = [standing(run) for run in runs]
    pairs = [(run, one) for run in runs for one in marked(run, range(read_json(run.exam)["cases"]))]
    cases = [one for _, one in pairs]
    compared = row_of(pairs)
    rows = table(cases) + ([] if compared is None else [compared])
    name = " and ".join(said["domain"] + ("" if said["frozen"] else " (not frozen)") for said in exams)
    found = Counted(exams, pairs, rows, limits(cases), false_names(cases), name)
    write_report(runs[0].folder, found.rows, found.limits, found.wrong, name, [one["done"] for one in exams])
    return found
