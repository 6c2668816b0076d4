"""Commands that make or read runs: drive, tune, verify, replay. Each imports its job when it is called."""

from __future__ import annotations

from collections.abc import Iterable

from tunefree_hil.base.events import Event
from tunefree_hil.cli.options import command, session_of
from tunefree_hil.jobs.options.records import DriveOptions, ReplayOptions, TuneOptions, VerifyOptions


@command("drive")
def drive(options: DriveOptions) -> Iterable[Event]:
    """Drive scenarios over the bus and score them."""
    yield Event("note", f"drive {options.bench}")
    from tunefree_hil.jobs.drive import drive as start

    yield from start(options._replace(session=session_of(options.session, options.join)))


@command("tune")
def tune(options: TuneOptions) -> Iterable[Event]:
    """Find the parameters of the controller.

    Trial by trial on the bench; the run folder explains why the winner wins. The same command resumes an unfinished run
    and starts a new one after a finished run. --resume continues the given run, even a finished one (with more
    --trials).
    """
    yield Event("note", f"tune {options.bench or options.resume or ''}".strip())
    from tunefree_hil.jobs.tune.tune import tune as start

    yield from start(options._replace(session=session_of(options.session, options.join)))


@command("verify")
def verify(options: VerifyOptions) -> Iterable[Event]:
    """Drive the winner of a run on the verify model.

    The manual parameters are driven for comparison. Exit status 1 if one of them is better or the winner fails.
    """
    yield Event("note", f"verify {options.run}")
    from tunefree_hil.jobs.tune.verify import verify as start

    yield from start(options._replace(session=session_of(options.session, options.join)))


@command("replay")
def replay(options: ReplayOptions) -> Iterable[Event]:
    """Check the logs of a run.

    With --verify the run is driven again and every frame is compared. Exit status 1 if frames differ.
    """
    yield Event("note", f"replay {options.run}")
    from tunefree_hil.jobs.replay import replay as start

    yield from start(options)
