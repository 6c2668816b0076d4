"""Command line of tools/reproduce: which parts run, where their records go, and the page that is made of them."""

from __future__ import annotations

import argparse
import importlib
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from tools.measures._ledger import ROOT
from tools.reproduction.context import Context, Folders, PartProgress, read_checkout, work_folder
from tools.reproduction.page import PAGE_NAME, write_page
from tools.reproduction.records import Origin, Record, read_record, write_record
from tunefree_hil.base.errors import InputError, TunefreeError

RECORDS = ROOT / "docs" / "results" / "reproduction"
FIGURES = ROOT / "docs" / "figures" / "reproduction"
PAGE = ROOT / "docs" / "results" / PAGE_NAME
INTERRUPTED = 130  # exit status


class Part(NamedTuple):
    """A figure or table.

    Attributes:
        name: On the command line, and of its files.
        module: In this folder.
        function: Context -> Record.
        full_s: Expected on two cores where nothing is there yet; parts before it in the list are done.
        quick_s: The same with --quick.
    """

    name: str
    module: str
    function: str
    full_s: float
    quick_s: float


# In the order of a run: a part finds what earlier ones have learned and searched.
PARTS = (
    Part("fig3b", "fig3b", "reproduce", 900.0, 90.0),
    Part("fig4", "fig4", "reproduce", 60.0, 12.0),
    Part("table1", "table1", "reproduce", 40.0, 8.0),
    Part("fig8a", "fig8", "reproduce_results", 240.0, 15.0),
    Part("fig8b", "fig8", "reproduce_samples", 5.0, 2.0),
    Part("fig9", "fig9", "reproduce_figure", 90.0, 15.0),
    Part("table4", "fig9", "reproduce_table", 5.0, 3.0),
    Part("fig10", "fig10", "reproduce", 200.0, 8.0),
    Part("fig11", "fig11", "reproduce", 5.0, 3.0),
    Part("table5", "table5", "reproduce", 420.0, 25.0),
    Part("table3", "table3", "reproduce", 60.0, 10.0),
)
NAMES = tuple(part.name for part in PARTS)


class Options(NamedTuple):
    """The command line. out: None for docs/. work: None for a folder under runs/."""

    names: tuple[str, ...]
    is_quick: bool = False
    is_full: bool = False
    out: Path | None = None
    page_only: bool = False
    seed: int = 1
    work: Path | None = None

    def folders(self) -> Folders:
        """Where records and pictures go, and where the work is kept."""
        work = self.work or work_folder(self.is_quick)
        if self.out is not None:
            return Folders(self.out, self.out, work)
        return Folders(work / "result", work / "result", work) if self.is_quick else Folders(RECORDS, FIGURES, work)

    def page(self) -> Path:
        """The page that is written after all parts."""
        folders = self.folders()
        return PAGE if folders.records == RECORDS else folders.records / PAGE_NAME


def main(words: Sequence[str]) -> int:
    """Run. Returns the exit status: 0, that of the error, or 130."""
    try:
        return run(parse(words))
    except TunefreeError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_status
    except KeyboardInterrupt:
        print("interrupted; the same command goes on", file=sys.stderr)
        return INTERRUPTED


def parse(words: Sequence[str]) -> Options:
    """The command line as options. Raises InputError for what does not fit together."""
    parser = argparse.ArgumentParser("tools/reproduce", description="The paper's figures and tables, measured again.")
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help=f"any of {', '.join(NAMES)}; default: all, and the page"
    )
    parser.add_argument(
        "--quick", action="store_true", help="small trials, which show that everything runs; no results"
    )
    parser.add_argument("--full", action="store_true", help="table5: whole searches over the bus, nothing extrapolated")
    parser.add_argument("--out", type=Path, help="folder of records, pictures and page; default: docs/")
    parser.add_argument("--page", action="store_true", help="only write the page from the records that are there")
    parser.add_argument("--seed", type=int, default=1, help="first seed of searches and trainings")
    parser.add_argument("--work", type=Path, help="folder of what an interrupted run needs; default: under runs/")
    given = parser.parse_args(words)
    unknown = [name for name in given.names if name not in NAMES]
    if unknown:
        raise InputError(
            f"no part {unknown[0]!r}", code="unknown_part", key="NAME", hint=f"use any of {', '.join(NAMES)}"
        )
    if given.quick and given.out is not None and _is_in_docs(given.out):
        raise InputError(
            "a quick run is no result", code="quick_in_docs", key="--out", hint="name a folder outside docs/"
        )
    if given.quick and given.full:
        raise InputError("--quick and --full exclude each other", code="bad_options", hint="leave one of them out")
    names = tuple(name for name in NAMES if name in given.names) or NAMES
    return Options(names, given.quick, given.full, _absolute(given.out), given.page, given.seed, _absolute(given.work))


def _absolute(folder: Path | None) -> Path | None:
    """A folder of the command line, which is named from where the user is."""
    return None if folder is None else folder.resolve()


def _is_in_docs(folder: Path) -> bool:
    return (ROOT / "docs").resolve() in (folder.resolve(), *folder.resolve().parents)


def run(options: Options) -> int:
    """The parts, each with its record; after all of them the page. Returns 0."""
    os.chdir(ROOT)  # bench files and measures are named from the root
    if not options.page_only:
        run_parts(options)
    records = options.folders().records
    missing = [name for name in NAMES if not (records / f"{name}.json").is_file()]
    if missing:
        print(f"no page yet, as these are missing: {', '.join(missing)}", file=sys.stderr)
        return 0
    print(write_page(options.page(), records, options.folders().figures, NAMES))
    return 0


def run_parts(options: Options) -> None:
    """Run the parts of the options, and print a line for each."""
    parts = [part for part in PARTS if part.name in options.names]
    progress = PartProgress({part.name: part.quick_s if options.is_quick else part.full_s for part in parts})
    context = Context(options.folders(), progress, options.is_quick, options.is_full, options.seed)
    for part in parts:
        progress.begin(part.name)
        began = time.monotonic()
        record = reproduce(part, context)
        seconds = time.monotonic() - began
        checkout = read_checkout()
        cpus = len(os.sched_getaffinity(0))
        origin = Origin(checkout.commit, checkout.changed_files, options.is_quick, seconds, cpus)
        path = write_record(context.folders.records, record, origin)
        progress.finish("met" if record.claim.is_met else "not met")
        print(f"{part.name}: {record.claim.text} {'Yes' if record.claim.is_met else 'No'}. {path}", flush=True)


def reproduce(part: Part, context: Context) -> Record:
    """The record of one part."""
    module = importlib.import_module(f"tools.reproduction.{part.module}")
    return getattr(module, part.function)(context)


__all__ = ["NAMES", "PARTS", "Options", "main", "parse", "read_record", "run"]
