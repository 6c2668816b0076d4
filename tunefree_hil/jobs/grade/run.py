"""Grade a log, or a run with the metrics of its drives combined."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.config.load import load_weights
from tunefree_hil.grade.oscillation.report import METRIC_SIGNALS
from tunefree_hil.grade.table import PUBLISHED
from tunefree_hil.jobs.grade.grade import grade_log, metric_lines
from tunefree_hil.jobs.grade.run_drives import ProfiledRun, read_run, split_run
from tunefree_hil.jobs.options.records import GradeOptions
from tunefree_hil.jobs.run_folder import RunFolder, open_run, write_json

SCHEMA = "tunefree.grade_run/1"
LOG = "vehicle.log"


def grade_any(text: str, options: GradeOptions) -> Iterator[Event]:
    """`grade_run` for a run, else `grade_log` for a log or the log in an episode's folder.

    Raises InputError for a run with options of a log.
    """
    if is_run(text):
        log_options = {
            "--vehicle": options.vehicle,
            "--path": options.path,
            "--start-s": options.start_s,
            "--out": options.out,
        }
        for key, value in log_options.items():
            if value is not None:
                hint = f"leave it out, or name the log: {text}/episodes/0/{LOG}"
                raise InputError("only allowed for a log, not for a run", code="usage", key=key, hint=hint)
        return grade_run(text, weights=options.weights)
    log = Path(text)
    log = log / LOG if (log / LOG).is_file() else log
    return grade_log(log, options)


def is_run(text: str) -> bool:
    """Whether this names a run (folder, `folder:NAME`, `folder/verify`) and not a log."""
    path, _ = split_run(text)
    return any((folder / "run.json").is_file() for folder in (path, path.parent if path.name == "verify" else path))


def grade_run(text: str, *, weights: str | None) -> Iterator[Event]:
    """One line a metric on stdout, combined over the scenarios; grade.json and figures in the run folder."""
    read = read_run(text, load_weights(weights) if weights else None)
    combined = read.combined()
    yield Event("note", f"{text}: {len(read.drives)} scenarios combined: {', '.join(read.drives)}")
    yield from (Event("line", line) for line in metric_lines(combined))
    yield Event("line", "scenarios")
    yield from (Event("line", line) for line in _scenarios(read))
    path, candidate = split_run(text)
    folder = open_run(path.parent if path.name == "verify" and not (path / "run.json").is_file() else path)
    suffix = "".join(f"-{part}" for part in ("verify" if path.name == "verify" else "", candidate) if part)
    data = _data(read)
    write_json(folder.path / f"grade{suffix}.json", {"schema": SCHEMA, **data})
    figure = _figure(folder, read, suffix)
    known = sum(combined[name].value is not None for name in PUBLISHED)
    score = "no score" if data["score"] is None else f"score {data['score']:.3f} by weights {read.weights.name!r}"
    ended = f"; not driven to the end: {', '.join(read.failed)}" if read.failed else ""
    shaking = oscillating_drives(read)
    ended += f"; OSCILLATES in {', '.join(shaking)}" if shaking else ""
    sentence = f"{known} of {len(PUBLISHED)} metrics available over {len(read.drives)} scenarios; {score}{ended}"
    yield Event("result", sentence, {"sentence": sentence, "run": str(folder.path), "figures": [figure], **data})


def oscillating_drives(read: ProfiledRun) -> list[str]:
    """Names of the scenarios in which a signal swings beyond its limit."""
    return [
        name
        for name, drive in read.drives.items()
        if any((drive.values[metric].value or 0.0) > 1.0 for metric in METRIC_SIGNALS)
    ]


def _scenarios(read: ProfiledRun) -> Iterator[str]:
    for name, drive in read.drives.items():
        score = "-" if drive.score is None else f"{drive.score:.4g}"
        yield f"  {name:<32}{score:>10}  {drive.outcome}, {drive.replans} re-plans"


def _data(read: ProfiledRun) -> dict[str, Any]:
    """Data of grade.json and --json."""
    return {
        "weights": read.weights.name,
        "score": read.score(),
        "metrics": {name: value._asdict() for name, value in read.combined().items()},
        "scenarios": {
            name: {
                "score": drive.score,
                "outcome": drive.outcome,
                "replans": drive.replans,
                "planned_samples": drive.planned_samples,
                "metrics": {metric: value._asdict() for metric, value in drive.values.items()},
            }
            for name, drive in read.drives.items()
        },
    }


def _figure(folder: RunFolder, read: ProfiledRun, suffix: str) -> str:
    from tunefree_hil.figures.profile import draw_profile
    from tunefree_hil.figures.style import save

    plain = {read.label: {name: value.value for name, value in read.combined().items()}}
    title = f"{read.label}: all metrics over {len(read.drives)} scenarios"
    if read.failed:
        title += f"\nnot driven to the end: {', '.join(read.failed)}"
    return str(save(draw_profile(plain, title), Path(folder.figures()) / f"profile{suffix}.png"))
