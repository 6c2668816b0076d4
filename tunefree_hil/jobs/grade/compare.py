"""Compare runs: every metric by scenario and combined, figures, and conditions for CI."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from enum import Enum
from typing import Any

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.grade.checks import FAILED, REPLANS, SCORE, Condition, check_condition, parse_condition
from tunefree_hil.grade.table import names_by_aspect
from tunefree_hil.jobs.drive import DEFAULT_ROOT
from tunefree_hil.jobs.grade.run_drives import ProfiledRun, read_run
from tunefree_hil.jobs.options.records import CompareOptions
from tunefree_hil.jobs.run_folder import RunFolder, write_json

SCHEMA = "tunefree.compare/1"
COMBINED = "combined"
EQUAL_TOLERANCE = 1e-9  # relative difference up to which two values count as equal
MIN_PERCENT = 0.05  # smaller differences are shown as 'about equal'
EXIT_CONDITION_HOLDS = 1  # exit status
DATE = re.compile(r"^\d{8}-\d{6}-")  # of a run folder

Table = dict[str, list[float | None]]  # metric -> value of each run


class MetricChange(Enum):
    """How a value differs from the first run's; the value is the text shown. Lower is better."""

    BETTER = "better"
    WORSE = "worse"
    EQUAL = "equal"
    BOTH_MISSING = "not available in both"
    MISSING = "not comparable"


def compare(options: CompareOptions) -> Iterator[Event]:
    """One line a metric on stdout, a block a scenario; compare.json and figures. Exit 1 when a condition holds."""
    runs = options.runs
    if len(runs) < 2:
        raise InputError("at least two runs are needed", code="usage", key="RUN", hint="give two or more runs")
    read, notes = _select_common(_labelled(_read_all(runs, options.weights)))
    names = list(read[0].drives)
    conditions = [parse_condition(text, names) for text in options.fail_if]
    yield from (Event("note", f"{run.label}: {text}") for run, text in zip(read, runs, strict=True))
    yield from (Event("warning", note) for note in notes)
    tables = {name: metric_table([run.only([name]) for run in read]) for name in names}
    tables[COMBINED] = metric_table(read)
    for name, table in tables.items():
        yield from (Event("line", line) for line in table_lines(name, [run.label for run in read], table))
    findings = [one for condition in conditions for one in check_condition(condition, _values(condition, read, tables))]
    yield from (
        Event("line", f"{'FAIL' if one.holds else 'ok'}  {one.condition}: {one.run}: {one.words}") for one in findings
    )
    record = {"command": "compare", "runs": list(runs), "weights": read[0].weights.name}
    folder = RunFolder.create(options.out or DEFAULT_ROOT, "compare", record)
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
        sentence += f"; CHECK FAILED: {len(failing)} of {len(findings)} conditions hold, first: {failing[0].words}"
    exit_status = EXIT_CONDITION_HOLDS if failing else 0
    yield Event("result", sentence, {"sentence": sentence, "exit": exit_status, "run": str(folder.path), **data})


def _read_all(runs: Sequence[str], weights: str | None) -> list[ProfiledRun]:
    """Read all runs, graded by the given weights, or by those of the first run."""
    from tunefree_hil.config.load import load_weights

    first = read_run(runs[0], load_weights(weights) if weights else None)
    return [first, *(read_run(text, first.weights) for text in runs[1:])]


def _labelled(read: list[ProfiledRun]) -> list[ProfiledRun]:
    """Unique short labels: the folder name without its date, numbered where names repeat."""
    short = [DATE.sub("", run.label) for run in read]
    return [
        run._replace(label=f"{name} ({i + 1})" if short.count(name) > 1 else name)
        for i, (run, name) in enumerate(zip(read, short, strict=True))
    ]


def _select_common(read: list[ProfiledRun]) -> tuple[list[ProfiledRun], list[str]]:
    """Reduce the runs to their common scenarios, with notes on the rest. Raises InputError when there is none."""
    absent, changed, names = [], [], []
    notes = []
    for name in dict.fromkeys(name for run in read for name in run.drives):
        lacking = [run.label for run in read if name not in run.drives]
        hashes = {run.drives[name].hash for run in read if name in run.drives} - {""}
        if lacking:
            absent.append(f"{name} is left out: not driven in {', '.join(lacking)}")
            notes.append(absent[-1])
        elif len(hashes) > 1:
            changed.append(f"{name} is left out: the runs drove different files of that name")
            notes.append(changed[-1])
        else:
            names.append(name)
    if not names:
        drove = "; ".join(f"{run.label} drove {', '.join(run.drives)}" for run in read)
        message = f"the runs have no common scenario: {'; '.join([drove, *changed])}"
        hint = "compare runs of the same bench file, or drive the missing scenario"
        raise InputError(message, code="nothing_common", hint=hint)
    return [run.only(names) for run in read], [*notes, *_setup_notes(read)]


def _setup_notes(read: Sequence[ProfiledRun]) -> list[str]:
    """Notes on other differences between the runs: vehicle and model."""
    notes = []
    for field in ("vehicle", "model"):
        names = {run.label: getattr(run, field) for run in read if getattr(run, field)}
        if len(set(names.values())) > 1:
            notes.append(f"not the same {field}: {', '.join(f'{label} {name}' for label, name in names.items())}")
    return notes


def metric_table(read: Sequence[ProfiledRun]) -> Table:
    """Score, re-plans, failed drives and all metrics, one value a run."""
    combined = [run.combined() for run in read]
    table: Table = {SCORE: [run.score() for run in read]}
    table[REPLANS] = [float(sum(drive.replans for drive in run.drives.values())) for run in read]
    table[FAILED] = [float(len(run.failed)) for run in read]
    for names in names_by_aspect().values():
        table |= {name: [values[name].value for values in combined] for name in names}
    return table


def compare_values(first: float | None, value: float | None) -> MetricChange:
    """Change of a metric against the first run; less than MIN_PERCENT counts as equal."""
    if first is None or value is None:
        return MetricChange.BOTH_MISSING if first is None and value is None else MetricChange.MISSING
    if math.isclose(first, value, rel_tol=EQUAL_TOLERANCE, abs_tol=1e-12):
        return MetricChange.EQUAL
    if first > 0.0 and abs(100.0 * (value / first - 1.0)) < MIN_PERCENT:
        return MetricChange.EQUAL
    return MetricChange.BETTER if value < first else MetricChange.WORSE


def change_text(first: float | None, value: float | None) -> str:
    """Text such as 'better -3.2 %' or 'equal'."""
    change = compare_values(first, value)
    if first is None or value is None:
        return change.value
    if change is MetricChange.EQUAL:
        return "equal" if math.isclose(first, value, rel_tol=EQUAL_TOLERANCE, abs_tol=1e-12) else "about equal"
    return f"{change.value} {100.0 * (value / first - 1.0):+.1f} %" if first > 0.0 else change.value


def table_lines(name: str, labels: Sequence[str], table: Table) -> list[str]:
    """Block of one scenario: a line a metric, a column a run, and the change of each run but the first."""
    widths = [max(10, len(label)) for label in labels]
    head = "  ".join(f"{label:>{width}}" for label, width in zip(labels, widths, strict=True))
    lines = [f"{name}:", f"  {'':<32}{head}  (lower is better; change against the first run)"]
    aspects = {name: aspect for aspect, names in names_by_aspect().items() for name in names}
    last = ""
    for metric, values in table.items():
        aspect = aspects.get(metric, "")
        if aspect != last:
            lines.append(f"  -- {aspect}")
            last = aspect
        cells = "  ".join(f"{_number(value):>{width}}" for value, width in zip(values, widths, strict=True))
        changes = ", ".join(change_text(values[0], value) for value in values[1:])
        lines.append(f"  {metric:<32}{cells}  {changes}")
    return lines


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def _values(condition: Condition, read: Sequence[ProfiledRun], tables: Mapping[str, Table]) -> dict[str, float | None]:
    """Values that a condition compares, by run."""
    values = tables[condition.scenario or COMBINED][condition.metric]
    return {run.label: value for run, value in zip(read, values, strict=True)}


def _sentence(read: Sequence[ProfiledRun], table: Table) -> str:
    """Combined scores, and the number of metrics that are better or worse than in the first run."""
    scores = table[SCORE]
    parts = [f"score {_number(scores[0])} ({read[0].label})"]
    metrics = [values for name, values in table.items() if name not in (SCORE, REPLANS, FAILED)]
    for i, run in enumerate(read[1:], 1):
        changes = [compare_values(values[0], values[i]) for values in metrics]
        better, worse = changes.count(MetricChange.BETTER), changes.count(MetricChange.WORSE)
        text = change_text(scores[0], scores[i])
        parts.append(f"{_number(scores[i])} ({run.label}: {text}; {better} metrics better, {worse} worse)")
    return " -> ".join(parts) + f" over {len(read[0].drives)} scenarios"


def _figures(folder: RunFolder, read: Sequence[ProfiledRun], tables: Mapping[str, Table]) -> list[str]:
    from tunefree_hil.figures.profile import draw_highlights, draw_profile
    from tunefree_hil.figures.scenario import DrivePicture, draw_scenario
    from tunefree_hil.figures.style import save

    def by_run(table: Table) -> dict[str, dict[str, float | None]]:
        return {run.label: {name: values[i] for name, values in table.items()} for i, run in enumerate(read)}

    figures, combined = folder.figures(), by_run(tables[COMBINED])
    over = f"over {len(read[0].drives)} scenarios{_failed_drives_text(read)}"
    written = [save(draw_highlights(combined, f"Highlighted metrics {over}"), figures / "highlights.png")]
    written.append(save(draw_profile(combined, f"All metrics {over}"), figures / "profile.png"))
    for name in read[0].drives:
        drives = []
        for run in read:
            drive = run.drives[name]
            drives.append(DrivePicture(run.label, drive.recording.columns, drive.score, drive.outcome))
        written.append(save(draw_scenario(name, drives), figures / f"{name}.png"))
        written.append(save(draw_highlights(by_run(tables[name]), name), figures / f"{name}_highlights.png"))
    return [str(path) for path in written]


def _failed_drives_text(read: Sequence[ProfiledRun]) -> str:
    """Second line of a title: drives that did not reach their end; their metrics are those of the driven part."""
    texts = [f"{run.label}: {', '.join(run.failed)}" for run in read if run.failed]
    return f"\nnot driven to the end: {'; '.join(texts)}" if texts else ""
