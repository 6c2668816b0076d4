"""What the measures of the exam of `gap` share: asking, or going on with, and the whole table as detail."""

from __future__ import annotations

import hashlib
import sys
from pathlib import Path
from typing import Any, NamedTuple

from tools.gap_exam import report
from tools.gap_exam.beside import compare_all
from tools.gap_exam.call import call
from tools.gap_exam.files import Run
from tools.gap_exam.prepare import Frozen
from tools.gap_exam.recordings import NoRecording
from tools.gap_exam.score import marked
from tools.gap_exam.seal import Broken
from tools.gap_exam.seeds import domain_of
from tools.gap_exam.session import Wish, conduct, count
from tools.measures._summary import rounded
from tunefree_hil.base.errors import InputError

ROOT = Path(__file__).resolve().parents[2]
RUN, RECORDINGS = "runs/gap_exam", "../shared/data"
HOURS = 8.0  # that a whole exam may take (issue 6)


class Asked(NamedTuple):
    """Options as they were given, all words and numbers; '' and 0 are none."""

    run: str
    domain: str
    rows: str
    part: str
    logs: int
    hours: float
    recordings: str = RECORDINGS
    sample: bool = False
    unfrozen: bool = False
    beside: int = 0  # logs that are compared with a network


def asked(options: Asked, *more: str) -> dict[str, Any]:
    """Ask what is not answered yet, then count: standing of the run, table, limits, wrong names, opened cases.

    more: folders of later exams, which are pooled with it. The page, the JSON and the pictures lie in the run's folder.
    """
    recordings = Path(options.recordings)
    wish = Wish(
        Path(options.run),
        domain_of(options.domain) if options.domain else None,
        options.sample,
        tuple(options.rows.split(",")) if options.rows else (),
        options.part,
        options.logs,
        options.hours,
        recordings if options.recordings and recordings.is_dir() else None,
        unfrozen=options.unfrozen,
    )
    try:
        exam = conduct(wish)
        if options.beside:
            run = Run(wish.run)
            compare_all(run, exam, marked(run, range(len(exam.cases))), options.beside)
        return counted([Run(Path(folder)) for folder in (options.run, *more)])
    except (Frozen, NoRecording, Broken, ValueError) as error:
        raise InputError(str(error), code="exam", key="--run", hint="see tools/gap_exam/README.md") from error


def counted(runs: list[Run]) -> dict[str, Any]:
    """All of what is answered, with how much that is; table.md and the pictures lie in the first run's folder."""
    found = count(runs)
    for run, stand in zip(runs, found.exams, strict=True):
        print(f"{run.folder}: {stand['done']}{'' if stand['whole'] else ', not the whole exam'}", file=sys.stderr)
    data = report.as_json(found.rows, found.limits, found.wrong, found.name)
    return {
        "exams": found.exams,
        "rows": {row["name"]: row for row in rounded(data["rows"])},
        "limits": {one.name: {**one._asdict(), "words": report.limit_words(one)} for one in found.limits},
        "wrong": found.wrong,
        "failed": [one.number for _, one in found.cases if one.mark.outcome == "failed"],
        "page": str(runs[0].folder / "table.md"),
    }


def answer_of(detail: dict[str, Any], row: str, figure: str = "right") -> dict[str, Any]:
    """A share of a row as a measure's answer, in percent. Raises InputError where no log of the row is answered."""
    found = detail["rows"].get(row, {}).get("figures", {}).get(figure)
    if found is None:
        done = "; ".join(one["done"] for one in detail["exams"])
        raise InputError(f"no log of the row '{row}' is answered yet: {done}", code="exam", hint="let the exam go on")
    value, low, high = (100.0 * found[key] for key in ("value", "low", "high"))
    return {"value": value, "unit": "percent", "n": found["n"], "low": low, "high": high, "detail": rounded(detail)}


def code_hash() -> str:
    """12 hex digits over the package's Python files: what a sample's answers hang on."""
    digest = hashlib.sha256()
    for path in sorted((ROOT / "tunefree_hil").rglob("*.py")):
        digest.update(path.relative_to(ROOT).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()[:12]


def there_is_gap() -> None:
    """Raises InputError where the command that is examined is not there: an exam of nothing is no figure."""
    try:
        starts = call("tunefree-hil gap --help", 60.0).status == 0
    except FileNotFoundError:
        starts = False
    if not starts:
        raise InputError("there is no command `tunefree-hil gap`", code="exam", hint="install the package: make venv")
