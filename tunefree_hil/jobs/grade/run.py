"""Grade what was named: a log, or a run, whose drives' metrics are taken together (apollo_facts 6.1)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.config.load import load_weights
from tunefree_hil.grade.align import Align
from tunefree_hil.grade.score import FINISHED
from tunefree_hil.grade.table import PUBLISHED
from tunefree_hil.jobs.grade.grade import grade_log, lines_of
from tunefree_hil.jobs.grade.run_drives import RunDrives, read_run, split_run
from tunefree_hil.jobs.run_folder import RunFolder, open_run, write_json

SCHEMA = "tunefree.grade_run/1"
LOG = "vehicle.log"
DEFAULT_WEIGHTS = "default"


def grade_any(
    text: str,
    *,
    vehicle: str | None,
    path: str | None,
    align: Align,
    start_s: float | None,
    weights: str | None,
    out: Path | None,
) -> Iterator[Event]:
    """`grade_run` of a run, else `grade_log` of a log or of the log in an episode's folder.

    weights: None for the run's own, or for a log DEFAULT_WEIGHTS. Raises InputError for a run with options of a log.
    """
    if is_run(text):
        given = {"--vehicle": vehicle, "--path": path, "--start-s": start_s, "--out": out}
        for key, value in given.items():
            if value is not None:
                hint = f"leave it out, or name the log: {text}/episodes/0/{LOG}"
                raise InputError("is for a log; a run knows its own", code="usage", key=key, hint=hint)
        return grade_run(text, weights=weights)
    log = Path(text)
    log = log / LOG if (log / LOG).is_file() else log
    options = {"vehicle": vehicle, "path": path, "align": align, "start_s": start_s, "out": out}
    return grade_log(log, weights=weights or DEFAULT_WEIGHTS, **options)


def is_run(text: str) -> bool:
    """Whether this names a run (folder, `folder:NAME`, `folder/verify`) and not a log."""
    path, _ = split_run(text)
    return any((folder / "run.json").is_file() for folder in (path, path.parent if path.name == "verify" else path))


def grade_run(text: str, *, weights: str | None) -> Iterator[Event]:
    """One line a metric on stdout, combined over the scenarios; grade.json and figures in the run folder."""
    read = read_run(text, load_weights(weights) if weights else None)
    combined = read.combined()
    yield Event("note", f"{text}: {len(read.drives)} scenarios taken together: {', '.join(read.drives)}")
    yield from (Event("line", line) for line in lines_of(combined))
    yield Event("line", "scenarios")
    yield from (Event("line", line) for line in _scenarios(read))
    path, candidate = split_run(text)
    folder = open_run(path.parent if path.name == "verify" and not (path / "run.json").is_file() else path)
    suffix = "".join(f"-{part}" for part in ("verify" if path.name == "verify" else "", candidate) if part)
    data = _data(read)
    write_json(folder.path / f"grade{suffix}.json", {"schema": SCHEMA, **data})
    figure = _figure(folder, read, suffix)
    had, failed = sum(combined[name].value is not None for name in PUBLISHED), _failed(read)
    score = "no score" if data["score"] is None else f"score {data['score']:.3f} by weights {read.weights.name!r}"
    ended = f"; not driven to the end: {', '.join(failed)}" if failed else ""
    sentence = f"{had} of {len(PUBLISHED)} metrics over {len(read.drives)} scenarios; {score}{ended}"
    yield Event("result", sentence, {"sentence": sentence, "run": str(folder.path), "figures": [figure], **data})


def _failed(read: RunDrives) -> list[str]:
    return [name for name, drive in read.drives.items() if drive.outcome != FINISHED]


def _scenarios(read: RunDrives) -> Iterator[str]:
    for name, drive in read.drives.items():
        score = "-" if drive.score is None else f"{drive.score:.4g}"
        yield f"  {name:<32}{score:>10}  {drive.outcome}, {drive.replans} re-plans"


def _data(read: RunDrives) -> dict[str, Any]:
    """What grade.json and --json hold."""
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


def _figure(folder: RunFolder, read: RunDrives, suffix: str) -> str:
    from tunefree_hil.figures.profile import write_profile

    plain = {read.label: {name: value.value for name, value in read.combined().items()}}
    title = f"{read.label}: all metrics over {len(read.drives)} scenarios"
    failed = _failed(read)
    if failed:
        title += f"\nnot driven to the end: {', '.join(failed)}"
    return str(write_profile(Path(folder.figures()) / f"profile{suffix}.png", plain, title))
