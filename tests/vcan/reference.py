"""What the drives of this folder come to over our hub: the links of a kernel are held against that.

    TUNEFREE_JIT=0 .venv/bin/python -m tests.vcan.reference FILE
    tools/vcan_vm --cpus 2 --env TUNEFREE_VCAN_REFERENCE=FILE --env ... -- .venv/bin/python -m pytest tests/vcan -m vcan

An emulated machine needs minutes for them, its host seconds: there they are driven before. Without such a file the
tests drive them where they are. Frames are the same to the bit on either; the last bit of a score is the processor's,
as numpy adds up otherwise on each.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

from tests.jobs.command import finish, new_session, no_orphans, start
from tests.vcan.peers import HERE, PATIENCE_S, PROGRAM, SCENARIO, controller_of
from tunefree_hil.bench import Bench, load, parameters_of
from tunefree_hil.jobs.run_folder import RunFolder
from tunefree_hil.jobs.running.episode_results import EpisodeResult
from tunefree_hil.jobs.running.foreign import controller_program, with_controller_command
from tunefree_hil.jobs.running.session import BenchLaunch, BenchSession
from tunefree_hil.jobs.running.trial_driver import TrialDriver
from tunefree_hil.tune.study import read_study

GIVEN = "TUNEFREE_VCAN_REFERENCE"
EXACT = 1e-9  # of a score: what another processor may make of the same frames
ORPHANS_S = 60.0


class Driven(NamedTuple):
    """An episode, as far as it is compared."""

    hash: str
    outcome: str
    replans: int
    score: float


class Tuned(NamedTuple):
    """What a tune left in its study."""

    baselines: dict[str, float]
    trials: list[tuple[int, dict[str, float], float]]
    failures: list[str]


class Reference(NamedTuple):
    """The scenarios of bench.toml, one of them by the C controller, and the tune of tune.toml."""

    drives: dict[str, Driven]
    foreign: Driven | None
    tune: Tuned


def compared(episode: EpisodeResult) -> Driven:
    """The same of a drive over whatever bus."""
    return Driven(episode.hash, episode.grade.outcome, episode.grade.replans, episode.grade.score)


def tuned(out: Path) -> Tuned:
    """The same of a tune, from the only run in its folder."""
    (run,) = out.glob("*")
    with read_study(run / "study.db") as study:
        trials = [(trial.slot, dict(trial.parameters), trial.score) for trial in study.trials()]
        baselines = {name: one.score for name, one in study.baselines().items()}
        return Tuned(baselines, trials, [failure.error for failure in study.failures()])


def tune_words(out: Path, session: str, *bus: str) -> tuple[Any, ...]:
    """The command; the same words go on where an earlier one was cut off."""
    return ("tune", HERE / "tune.toml", "--no-verify", "--out", out, "--session", session, "--json", *bus)


def made(folder: Path) -> Reference:
    """Drive all of it over the hub, here and now. The C controller only where it can be built."""
    bench = load(HERE / "bench.toml")
    drives = _driven(folder / "drives", bench, bench.spec.scenarios)
    foreign, program = None, controller_of()
    if program is not None:
        with_it = with_controller_command(bench, PROGRAM.format(program=program))
        (foreign,) = _driven(folder / "foreign", with_it, [SCENARIO], controller_program(with_it)).values()
    session = new_session()
    with no_orphans(session, ORPHANS_S):
        ended = finish(start(*tune_words(folder / "tune", session, "--bus", "tfhub", "--benches", "1")), PATIENCE_S)
    assert ended.status == 0, ended.words
    return Reference(drives, foreign, tuned(folder / "tune"))


def reference_of(folder: Path) -> Reference:
    """From the file that was given, else made in `folder`."""
    given = os.environ.get(GIVEN)
    if not given:
        return made(folder)
    said = json.loads(Path(given).read_text())
    drives = {name: Driven(*one) for name, one in said["drives"].items()}
    baselines, trials, failures = said["tune"]
    trials = [(slot, parameters, score) for slot, parameters, score in trials]
    return Reference(drives, Driven(*said["foreign"]) if said["foreign"] else None, Tuned(baselines, trials, failures))


def _driven(folder: Path, bench: Bench, names: Any, command: Any = None) -> dict[str, Driven]:
    run = RunFolder(folder, {})
    words = {"controller_command": command} if command else {}
    with BenchSession(
        HERE / "bench.toml", run.node_output(), BenchLaunch(session=new_session(), bus="tfhub", **words)
    ) as session:
        track = TrialDriver(session, bench, run)
        try:
            episodes = track.drive_scenarios(parameters_of(bench), [bench.scenarios[name] for name in names], 0)
        finally:
            track.close()
    return {name: compared(episode) for name, episode in episodes.items()}


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        text = json.dumps(made(Path(place))._asdict(), indent=1)
    Path(sys.argv[1]).write_text(text + "\n")
