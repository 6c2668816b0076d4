"""The run folder of a `tune`: the one to resume, an unfinished one of the same settings, or a new one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import Bench
from tunefree_hil.jobs.drive import DEFAULT_ROOT
from tunefree_hil.jobs.identity import resolved_toml
from tunefree_hil.jobs.run_folder import RunFolder, iterate_unfinished, open_run, remove_partial_files, write_text
from tunefree_hil.jobs.tune.options import OPTIONS, TunePlan
from tunefree_hil.tune.store import exclusive_lock

LOCK = "worker"  # name of the lock in the run folder


@contextmanager
def open_run_folder(plan: TunePlan) -> Iterator[tuple[RunFolder, bool]]:
    """Open the run folder and lock it: two processes would write the same episodes.

    Workers of a shared study on one machine have a folder each.

    Yields:
        The folder, and whether it existed before.

    Raises:
        InputError: Another process has locked it.
    """
    options = plan.options
    name, root = f"tune-{plan.bench_file.stem}", options.out or DEFAULT_ROOT
    with ExitStack() as stack:
        if options.resume is not None:
            run: RunFolder | None = open_run(options.resume)
            _require_unchanged(run, plan)
            stack.enter_context(exclusive_lock(run.path / LOCK))
        else:
            run = _find_free_run(root, name, plan, stack)
        if run is not None:
            remove_partial_files(run.path)
            write_bench_file(run.path, plan.bench)
            # The options may differ from those of the earlier command.
            run.add_to_record(**{OPTIONS: plan.stored_options})
            yield run, True
            return
        record = {
            **plan.run_record,
            OPTIONS: plan.stored_options,
            "bench": str(plan.bench_file),
            "hashes": plan.identity["hashes"],
        }
        if plan.sampler_choice is not None:
            record["sampler_choice"] = plan.sampler_choice._asdict()

        def prepare(path: Path) -> None:
            stack.enter_context(exclusive_lock(path / LOCK))  # before another worker can open it
            write_bench_file(path, plan.bench)

        yield RunFolder.create(root, name, {**record, "seed": plan.settings.seed}, prepare), False


def write_bench_file(path: Path, bench: Bench) -> None:
    """Write the resolved bench file into a run folder, for `verify`, `replay` and `explain`.

    Its parts that scores depend on belong to the identity of a run; verify model and verify scenarios may change.
    """
    write_text(path / "bench.toml", resolved_toml(bench))


def _find_free_run(root: Path, name: str, plan: TunePlan, stack: ExitStack) -> RunFolder | None:
    """Find an unfinished folder of the same settings and lock it; skip locked ones of a shared study."""
    for run in iterate_unfinished(root, name, plan.run_record):
        try:
            stack.enter_context(exclusive_lock(run.path / LOCK))
            return run
        except InputError:
            if not plan.study_address:
                raise
    return None


def _require_unchanged(run: RunFolder, plan: TunePlan) -> None:
    """Raise InputError where the files of the run have changed, or its study is stored elsewhere."""
    if run.record.get("identity") != plan.identity["identity"]:
        raise InputError(
            "the files of the run have changed",
            code="changed",
            file=str(run.path),
            key="identity",
            hint="restore the vehicle, model, scenarios and weights, or start a new run",
        )
    stored = run.record.get("study", "")
    if stored != plan.study_address:
        hint = f"--study {stored}" if stored else "leave out --study"
        raise InputError(f"its study is in {stored or 'its study.db'}", code="changed", key="--study", hint=hint)
