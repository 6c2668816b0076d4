"""Writes the gains and the open-loop map of a run, or of a bench file, as files of another stack."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.base.events import Event
from tunefree_hil.jobs.export.apollo import export_apollo
from tunefree_hil.jobs.export.autoware import export_autoware
from tunefree_hil.jobs.export.remarks import Export, ExportFile, Remark, RemarkKind, page, remark_on_rest
from tunefree_hil.jobs.export.values import ExportValues, collect_values
from tunefree_hil.jobs.options.records import ExportOptions
from tunefree_hil.jobs.tune.verdict.best_file import NOT_VERIFIED

PAGE = "not_exported.md"
TARGETS: dict[str, Callable[[ExportValues], Export]] = {"apollo": export_apollo, "autoware": export_autoware}


def export(options: ExportOptions) -> Iterator[Event]:
    """Write the folder; a warning for each way in which the target will behave differently."""
    if options.out.exists() and (not options.out.is_dir() or any(options.out.iterdir())):
        raise InputError(
            "is there already and not empty",
            code="bad_out",
            file=str(options.out),
            key="--out",
            hint="name a new folder",
        )
    source = collect_values(options.source, options.set_name)
    made = TARGETS[options.target](source)
    remarks = [*made.remarks, *remark_on_rest(source.values, made.exported, made.remarks)]
    title = f"What {options.target} does not take over"
    files = [*made.files, ExportFile(PAGE, page(title, describe_source(source), remarks))]
    write_folder(options.out, files)
    if source.verdict == NOT_VERIFIED:
        yield Event("warning", "the winner is not verified yet: run `tunefree-hil verify` first")
    for remark in remarks:
        if remark.kind is RemarkKind.DIFFERS:
            yield Event("warning", f"{remark.subject}: {remark.text}")
    for file in files:
        yield Event("line", str(options.out / file.name))
    yield Event("result", "", result_data(options, source, files, remarks))


def describe_source(source: ExportValues) -> list[str]:
    """Two lines for the head of the page."""
    verdict = f", verdict: {source.verdict}" if source.verdict else ""
    return [
        f"Exported: `{source.set_name}` of {source.source}{verdict}. Vehicle {source.vehicle_name}.",
        f"Driven with lateral = {source.parts.lateral}, longitudinal = {source.parts.longitudinal},"
        f" inner = {source.parts.inner}.",
    ]


def result_data(
    options: ExportOptions, source: ExportValues, files: Sequence[ExportFile], remarks: Sequence[Remark]
) -> dict[str, object]:
    """The data of the result."""
    left_out = [remark.subject for remark in remarks if remark.kind is RemarkKind.NOT_EXPORTED]
    sentence = (
        f"exported {source.set_name} of {source.source} for {options.target}: {len(files)} files in {options.out};"
    )
    return {
        "sentence": f"{sentence} {len(left_out)} values have no counterpart ({PAGE})",
        "target": options.target,
        "set": source.set_name,
        "verdict": source.verdict,
        "files": [str(options.out / file.name) for file in files],
        "not_exported": left_out,
        "differs": [remark.subject for remark in remarks if remark.kind is RemarkKind.DIFFERS],
        "next": [],
    }


def write_folder(out: Path, files: Sequence[ExportFile]) -> None:
    """Write all files under a temporary name, then rename the folder: it is there whole or not at all."""
    part = out.with_name(f"{out.name}.part")
    try:
        shutil.rmtree(part, ignore_errors=True)
        for file in files:
            path = part / file.name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(file.text, encoding="utf-8")
        os.replace(part, out)  # an empty folder of that name is replaced
    except OSError as error:
        shutil.rmtree(part, ignore_errors=True)
        hint = "check the folder, its permissions and the space on the disk, then run the same command"
        raise BenchError(f"cannot write: {error.strerror}", code="disk", file=str(out), hint=hint) from error
