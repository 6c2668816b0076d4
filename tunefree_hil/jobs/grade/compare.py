"""Compare runs: every metric side by side, by scenario and combined, figures, and conditions that fail a CI."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.grade.checks import FAILED, REPLANS, SCORE, Condition, judge_condition, parse_condition
from tunefree_hil.grade.score import FINISHED
from tunefree_hil.grade.table import by_aspect
from tunefree_hil.jobs.drive import DEFAULT_ROOT
from tunefree_hil.jobs.grade.run_drives import RunDrives, read_run
from tunefree_hil.jobs.report_text import early
from tunefree_hil.jobs.run_folder import RunFolder, write_json

SCHEMA = "tunefree.compare/1"
COMBINED = "combined"
SAME = 1e-9  # relative difference below which two values are called equal
LEAST_PERCENT = 0.05  # below it a difference is not worth a word
FAILS = 1  # exit status
DATE = re.compile(r"^\d{8}-\d{6}-")  # of a run folder

Table = dict[str, list[float | None]]  # metric -> value of each run


def compare(runs: Sequence[str], *, fail_if: Sequence[str], weights: str | None, out: Path | None) -> Iterator[Event]:
    """One line a metric on stdout, a block a scenario; compare.json and figures. Exit 1 when a condition holds."""
    if len(runs) < 2:
        raise InputError("one run has nothing to be compared with", code="usage", key="RUN", hint="give two or more")
    read, notes = _common(_labelled(_read_all(runs, weights)))
    names = list(read[0].drives)
    conditions = [parse_condition(text, names) for text in fail_if]
    yield from (Event("note", f"{run.label}: {text}") for run, text in zip(read, runs, strict=True))
    yield from (Event("warning", note) for note in notes)
    tables = {name: table_of([run.only([name]) for run in read]) for name in names}
    tables[COMBINED] = table_of(read)
    for name, table in tables.items():
        yield from (Event("line", line) for line in lines_of(name, [run.label for run in read], table))
    findings = [one for condition in conditions for one in judge_condition(condition, _values(condition, read, tables))]
    yield from (
        Event("line", f"{'FAIL' if one.holds else 'ok'}  {one.condition}: {one.run}: {one.words}") for one in findings
    )
    record = {"command": "compare", "runs": list(runs), "weights": read[0].weights.name}
    folder = RunFolder.create(out or DEFAULT_ROOT, "compare", record)
    failing = [one for one in findings if one.holds]
    data: dict[str, Any] = {
        "runs": [run.label for run in read],
        "folders": list(runs),
        "scenarios": names,
        "notes": notes,
        "tables": tables,
        "findings": [one._asdict() for one in findings],
        "figures": _figures(folder, read, tables),
    }
    write_json(folder.path / "compare.json", {"schema": SCHEMA, **data})
    folder.finish()
    sentence = _sentence(read, tables[COMBINED])
    if failing:
        sentence += f"; {len(failing)} of {len(findings)} conditions hold, first: {failing[0].words}"
    exit_status = FAILS if failing else 0
    yield Event("result", sentence, {"sentence": sentence, "exit": exit_status, "run": str(folder.path), **data})


def _read_all(runs: Sequence[str], weights: str | None) -> list[RunDrives]:
    """All judged by the weights that were named, or by the first run's."""
    from tunefree_hil.config.load import load_weights

    first = read_run(runs[0], load_weights(weights) if weights else None)
    return [first, *(read_run(text, first.weights) for text in runs[1:])]


def _labelled(read: list[RunDrives]) -> list[RunDrives]:
    """Short labels that differ: the folder without its date, with the run's place where that is not enough."""
    short = [DATE.sub("", run.label) for run in read]
    return [
        run._replace(label=f"{name} ({i + 1})" if short.count(name) > 1 else name)
        for i, (run, name) in enumerate(zip(read, short, strict=True))
    ]


def _common(read: list[RunDrives]) -> tuple[list[RunDrives], list[str]]:
    """The scenarios that all runs drove, and what is left out. Raises InputError when there is none."""
    notes, names = [], []
    every = dict.fromkeys(name for run in read for name in run.drives)
    for name in every:
        lacking = [run.label for run in read if name not in run.drives]
        hashes = {run.drives[name].hash for run in read if name in run.drives} - {""}
        if lacking:
            notes.append(f"{name} is left out: not driven in {', '.join(lacking)}")
        elif len(hashes) > 1:
            notes.append(f"{name} is left out: the runs drove different files of that name")
        else:
            names.append(name)
    if not names:
        drove = "; ".join(f"{run.label} drove {', '.join(run.drives)}" for run in read)
        changed = [note for note in notes if "different files" in note]
        raise InputError(
            f"the runs have no scenario in common: {'; '.join([drove, *changed])}",
            code="nothing_common",
            hint="compare runs of the same bench file, or drive the missing scenario",
        )
    return [run.only(names) for run in read], [*notes, *_unlike(read)]


def _unlike(read: Sequence[RunDrives]) -> list[str]:
    """What else differs than what is compared: another vehicle, another plant."""
    notes = []
    for what in ("vehicle", "model"):
        found = {run.label: getattr(run, what) for run in read if getattr(run, what)}
        if len(set(found.values())) > 1:
            notes.append(f"not the same {what}: {', '.join(f'{label} {name}' for label, name in found.items())}")
    return notes


def table_of(read: Sequence[RunDrives]) -> Table:
    """Score, re-plans, failed drives and all metrics, one value a run."""
    combined = [run.combined() for run in read]
    table: Table = {SCORE: [run.score() for run in read]}
    table[REPLANS] = [float(sum(drive.replans for drive in run.drives.values())) for run in read]
    table[FAILED] = [float(sum(drive.outcome != FINISHED for drive in run.drives.values())) for run in read]
    for names in by_aspect().values():
        table |= {name: [values[name].value for values in combined] for name in names}
    return table


def verdict(first: float | None, other: float | None) -> str:
    """'better' or 'worse' than the first run by how much, 'equal', or that it cannot be told. Lower is better."""
    if first is None or other is None:
        return "neither has it" if first is None and other is None else "cannot be told"
    if math.isclose(first, other, rel_tol=SAME, abs_tol=1e-12):
        return "equal"
    word = "better" if other < first else "worse"
    if first <= 0.0:
        return word
    percent = 100.0 * (other / first - 1.0)
    return f"{word} {percent:+.1f} %" if abs(percent) >= LEAST_PERCENT else "about equal"


def lines_of(name: str, labels: Sequence[str], table: Table) -> list[str]:
    """A block of one scenario: a line a metric, a column a run, and words about each but the first."""
    widths = [max(10, len(label)) for label in labels]
    head = "  ".join(f"{label:>{width}}" for label, width in zip(labels, widths, strict=True))
    lines = [f"{name}:", f"  {'':<32}{head}  (lower is better; words: against the first)"]
    aspects = {name: aspect for aspect, names in by_aspect().items() for name in names}
    last = ""
    for metric, values in table.items():
        aspect = aspects.get(metric, "")
        if aspect != last:
            lines.append(f"  -- {aspect}")
            last = aspect
        cells = "  ".join(f"{_number(value):>{width}}" for value, width in zip(values, widths, strict=True))
        words = ", ".join(verdict(values[0], value) for value in values[1:])
        lines.append(f"  {metric:<32}{cells}  {words}")
    return lines


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def _values(condition: Condition, read: Sequence[RunDrives], tables: Mapping[str, Table]) -> dict[str, float | None]:
    """What a condition looks at, by run."""
    values = tables[condition.scenario or COMBINED][condition.metric]
    return {run.label: value for run, value in zip(read, values, strict=True)}


def _sentence(read: Sequence[RunDrives], table: Table) -> str:
    """The combined scores, and in how many metrics the others are better or worse."""
    scores = table[SCORE]
    parts = [f"score {_number(scores[0])} ({read[0].label})"]
    for i, run in enumerate(read[1:], 1):
        words = [
            verdict(values[0], values[i]) for name, values in table.items() if name not in (SCORE, REPLANS, FAILED)
        ]
        better, worse = (sum(word.startswith(start) for word in words) for start in ("better", "worse"))
        said = verdict(scores[0], scores[i])
        parts.append(f"{_number(scores[i])} ({run.label}: {said}; {better} metrics better, {worse} worse)")
    return " -> ".join(parts) + f" over {len(read[0].drives)} scenarios"


def _figures(folder: RunFolder, read: Sequence[RunDrives], tables: Mapping[str, Table]) -> list[str]:
    from tunefree_hil.figures.profile import write_highlights, write_profile
    from tunefree_hil.figures.scenario import Drive, write_scenario

    def by_run(table: Table) -> dict[str, dict[str, float | None]]:
        return {run.label: {name: values[i] for name, values in table.items()} for i, run in enumerate(read)}

    figures, combined = folder.figures(), by_run(tables[COMBINED])
    over = f"over {len(read[0].drives)} scenarios{_failed_words(read)}"
    written = [write_highlights(figures / "highlights.png", combined, f"Highlighted metrics {over}")]
    written.append(write_profile(figures / "profile.png", combined, f"All metrics {over}"))
    for name in read[0].drives:
        drives = []
        for run in read:
            drive = run.drives[name]
            drives.append(Drive(run.label, drive.recording.columns, drive.score, early(drive.outcome)))
        written.append(write_scenario(figures / f"{name}.png", name, drives))
        written.append(write_highlights(figures / f"{name}_highlights.png", by_run(tables[name]), name))
    return [str(path) for path in written]


def _failed_words(read: Sequence[RunDrives]) -> str:
    """A second line of a title: drives that did not reach their end, whose metrics are those of the part driven."""
    failed = {run.label: [name for name, drive in run.drives.items() if drive.outcome != FINISHED] for run in read}
    words = [f"{label}: {', '.join(names)}" for label, names in failed.items() if names]
    return f"\nnot driven to the end: {'; '.join(words)}" if words else ""
