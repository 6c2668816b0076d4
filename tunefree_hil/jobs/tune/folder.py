"""The run folder of a `tune`: an unfinished one of the same wish, the one to resume, or a new one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import Bench
from tunefree_hil.jobs.drive import DEFAULT_ROOT
from tunefree_hil.jobs.identity import resolved_toml
from tunefree_hil.jobs.run_folder import RunFolder, all_unfinished, open_run, remove_parts, write_text
from tunefree_hil.jobs.tune.options import OPTIONS, Wish
from tunefree_hil.tune.store import alone

HELD = "worker"


@contextmanager
def run_folder_of(wish: Wish) -> Iterator[tuple[RunFolder, bool]]:
    """(folder, whether it is an old one): the one to resume, an unfinished one of the same settings, or a new one.

    It is held as long as the `with` lasts: two processes would write the same episodes. Workers of a shared study on
    one machine each hold a folder of their own. Raises InputError where another process holds it.
    """
    asked = wish.asked
    name, root = f"tune-{asked.bench.stem}", asked.out or DEFAULT_ROOT
    with ExitStack() as stack:
        if asked.resume is not None:
            run: RunFolder | None = open_run(asked.resume)
            _refuse_changed(run, wish)
            stack.enter_context(alone(run.path / HELD))
        else:
            run = _free(root, name, wish, stack)
        if run is not None:
            remove_parts(run.path)
            keep_bench(run.path, wish.bench)
            run.note(**{OPTIONS: wish.options})  # of this command, which may say others than the one before
            yield run, True
            return
        record = {**wish.record, OPTIONS: wish.options, "bench": str(asked.bench), "hashes": wish.identity["hashes"]}

        def prepare(path: Path) -> None:
            stack.enter_context(alone(path / HELD))  # before another worker can find it
            keep_bench(path, wish.bench)

        yield RunFolder.create(root, name, {**record, "seed": wish.settings.seed}, prepare), False


def keep_bench(path: Path, bench: Bench) -> None:
    """The bench file, resolved, into a run's folder: what `verify`, `replay` and `explain` of it go by. What scores
    depend on is in the run's identity; what the winner is verified on is not, and may be another than before.
    """
    write_text(path / "bench.toml", resolved_toml(bench))


def _free(root: Path, name: str, wish: Wish, stack: ExitStack) -> RunFolder | None:
    """An unfinished folder of the same settings; `stack` holds it from now on. Of those of a shared study one that no
    living worker holds.
    """
    for run in all_unfinished(root, name, wish.record):
        try:
            stack.enter_context(alone(run.path / HELD))
            return run
        except InputError:
            if not wish.shown:
                raise
    return None


def _refuse_changed(run: RunFolder, wish: Wish) -> None:
    """Raise InputError where a run was made with other files, or its study is elsewhere."""
    if run.record.get("identity") != wish.identity["identity"]:
        raise InputError(
            "the files it was made with have changed since",
            code="changed",
            file=str(run.path),
            key="identity",
            hint="bring back the vehicle, model, scenarios and weights, or start a new run",
        )
    before = run.record.get("study", "")
    if before != wish.shown:
        hint = f"--study {before}" if before else "leave out --study"
        raise InputError(f"its study is in {before or 'its study.db'}", code="changed", key="--study", hint=hint)
