"""What a `tune` was asked for, and what that comes to: checked before any process starts."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import Bench, load, own_parameters, parameters_of, require_buildable
from tunefree_hil.jobs.command_text import given, pasted
from tunefree_hil.jobs.drive import own_session
from tunefree_hil.jobs.identity import identity_of
from tunefree_hil.jobs.run_folder import open_run
from tunefree_hil.jobs.running.foreign import require_one, with_command
from tunefree_hil.jobs.running.node_links import bus_for
from tunefree_hil.jobs.running.session import lanes_of
from tunefree_hil.jobs.tune.candidates import baseline_vectors, opening_of
from tunefree_hil.tune.baselines import first_trial
from tunefree_hil.tune.shared.server import address_of
from tunefree_hil.tune.space import Space, resolve
from tunefree_hil.tune.store import Settings, check_settings

OPTIONS = "options"  # key of run.json
BATCH, BUS = "batch", "bus"
BATCH_IN_FLIGHT = 8  # costs nothing in quality (opt_anchors B)
SHARED_IN_FLIGHT = 0  # each worker asks when it is free
USUAL: Mapping[str, Any] = {"scale": "log", "verify": True, "confirm": 3}
MOST_SLOWER = 10.0  # what is written by mistake lies far beyond


class Asked(NamedTuple):
    """The options of the command, as given. benches, in_flight 0: as the bench file and the machine suggest; None: not
    said, so as the run that goes on has it, or else as the bench file or USUAL has it.
    """

    bench: Path
    trials: int | None = None
    set_name: str | None = None
    sampler: str | None = None
    seed: int | None = None
    scale: str | None = None
    bus: str = "auto"
    bench_bus: str = ""
    join: bool = False
    session: str = ""
    out: Path | None = None
    resume: Path | None = None
    verify: bool | None = None
    study: str | None = None
    backend: str = BUS
    benches: int = 0
    in_flight: int = 0
    realtime: bool = False
    controller: str = ""
    confirm: int | None = None


class Wish(NamedTuple):
    """What was asked for, resolved. shown: the shared study's address without its password, '' for none."""

    asked: Asked
    bench: Bench
    settings: Settings
    identity: dict[str, Any]
    vectors: dict[str, dict[str, float]]
    trials: int
    benches: int
    session: str
    shown: str
    command: str  # the same command again, to be pasted

    @property
    def record(self) -> dict[str, Any]:
        """What makes a run of this wish this run: an unfinished one that agrees is gone on with."""
        asked = self.asked
        return {
            "command": "tune",
            "identity": self.identity["identity"],
            "settings": self.settings.described(),
            "backend": asked.backend,
            "realtime": asked.realtime,
            "study": self.shown,
        }

    @property
    def confirm(self) -> int:
        """Of a batch, how many trials the bus drives again."""
        return int(self.asked.confirm or USUAL["confirm"])

    @property
    def options(self) -> dict[str, Any]:
        """What `--resume` goes on with where the command does not say otherwise: fields of Asked, in run.json too."""
        asked, settings = self.asked, self.settings
        return {
            "trials": self.trials,
            "set_name": asked.set_name,
            "sampler": settings.sampler,
            "seed": settings.seed,
            "scale": asked.scale,
            "verify": asked.verify,
            "confirm": asked.confirm,
        }


def resolve_wish(asked: Asked) -> Wish:
    """Read, check and work out everything. Raises InputError that names what does not fit."""
    asked = settled(_as_before(asked) if asked.resume else asked)
    _refuse_contradictions(asked)
    address = address_of(asked.study) if asked.study else None
    bench = with_command(load(asked.bench), asked.controller)
    _require_slower(bench)
    space = _space(bench, asked)
    _require_buildable(bench, asked, space)
    session = asked.session or own_session()
    bus_for(bench, asked.bus, session, asked.bench_bus)
    vectors = baseline_vectors(bench)
    require_one(bench, space.names, join=asked.join)
    identity = identity_of(bench, bench.spec.model, [bench.scenarios[name] for name in bench.spec.scenarios])
    benches = _benches(asked)
    settings = Settings(
        space=space,
        seed=bench.spec.seed if asked.seed is None else asked.seed,
        sampler=asked.sampler or bench.spec.tune.sampler,
        bench_hash=identity["identity"],
        first=first_trial(space, opening_of(vectors)),
        in_flight=_in_flight(bench, asked, benches),
    )
    check_settings(settings)  # before there is a run folder that nobody could go on with
    shown = f"{address.shown}#{address.name}" if address else ""
    trials = asked.trials or bench.spec.tune.trials
    return Wish(asked, bench, settings, identity, vectors, trials, benches, session, shown, again(asked, shown))


def _as_before(asked: Asked) -> Asked:
    """A run that goes on does so in its own way, whatever the options' defaults are.

    What the command says counts; a run of an earlier version has no `options`.
    """
    record = _tune_before(asked.resume) if asked.resume else {}
    usual, options = Asked._field_defaults, record.get(OPTIONS, {})
    return asked._replace(
        **{name: value for name, value in options.items() if getattr(asked, name) == usual[name]},
        backend=record.get("backend", asked.backend),
        realtime=record.get("realtime", asked.realtime),
        in_flight=record.get("settings", {}).get("in_flight", asked.in_flight),
    )


def settled(asked: Asked) -> Asked:
    """What nobody said is as usual."""
    return asked._replace(**{name: value for name, value in USUAL.items() if getattr(asked, name) is None})


def _tune_before(path: Path) -> dict[str, Any]:
    """run.json of the tune in `path`. Raises InputError for any other run: its episodes would be overwritten."""
    record = open_run(path).record
    command = record.get("command")
    if command != "tune":
        hint = "give the run folder of a tune, or leave --resume out for a new run"
        raise InputError(
            f"is a run of {command!r}: there is no search to go on with",
            code="not_a_tune", file=str(path), key="--resume", hint=hint,
        )  # fmt: skip
    return record


def _space(bench: Bench, asked: Asked) -> Space:
    tune = bench.spec.tune
    specs = [] if asked.set_name else tune.parameters
    name = asked.set_name or ("" if specs else tune.set)
    return resolve(name, specs, scale="" if asked.scale == "log" else asked.scale or "", file=bench.file)


def _refuse_contradictions(asked: Asked) -> None:
    """Raise InputError for two options that cannot both be."""
    given = {
        "--backend batch": asked.backend == BATCH,
        "--study": bool(asked.study),
        "--join": asked.join,
        "--benches": asked.benches > 1,
        "--realtime": asked.realtime,
        "--controller": bool(asked.controller),
        "--bus": asked.bus not in ("auto", "tfhub"),
    }
    pairs = {
        ("--backend batch", "--realtime"): "a batch has no time of its own",
        ("--backend batch", "--study"): "a batch is one process; workers share a study over the bus",
        ("--backend batch", "--controller"): "a batch knows our controller only",
        ("--join", "--benches"): "there is one bench to join",
        ("--join", "--realtime"): "whether joined nodes kept time cannot be read",
        ("--join", "--controller"): "the controller of a joined bench runs already",
        ("--bus", "--benches"): "each bench has a hub of its own",
    }
    for (one, other), why in pairs.items():
        if given[one] and given[other]:
            raise InputError(f"{one} and {other}: {why}", code="usage", key=other, hint=f"leave out {one} or {other}")


def _benches(asked: Asked) -> int:
    """How many benches run side by side; real time wants the machine for itself."""
    return asked.benches or (1 if asked.realtime else lanes_of(asked.join, asked.bus))


def _in_flight(bench: Bench, asked: Asked, benches: int) -> int:
    """Trials that are asked together: enough of them to keep every bench busy."""
    if asked.study:
        return SHARED_IN_FLIGHT
    wanted = asked.in_flight or bench.spec.tune.in_flight
    if asked.backend == BATCH:
        return wanted or BATCH_IN_FLIGHT
    return wanted or -(-benches // len(bench.spec.scenarios))


def _require_slower(bench: Bench) -> None:
    slower = bench.spec.tune.slower
    if not 1.0 <= slower <= MOST_SLOWER:
        raise InputError(
            f"{slower:g} does not do", code="bad_slower", file=bench.file, key="tune.slower",
            hint=f"from 1 (the winner is the best grade alone) to {MOST_SLOWER:g}; 1.5 is the default",
        )  # fmt: skip


def _require_buildable(bench: Bench, asked: Asked, space: Space) -> None:
    """Raise InputError for what a node could not build, now rather than after hours.

    With MRAC on, whatever the bench file says, where it is searched, and where the manual baselines are driven: some
    have it on.
    """
    values, spec = parameters_of(bench), bench.spec
    if not own_parameters(bench) or any(name.startswith("mrac.") for name in space.names):
        values["mrac.enable"] = 1.0
    scenarios = [bench.scenarios[name] for name in spec.scenarios]
    require_buildable(bench, spec.model, scenarios, values, realtime=asked.realtime)
    if asked.backend == BATCH and spec.controller.command:
        raise InputError(
            "a batch knows our controller only", code="usage", file=bench.file, key="controller.command",
            hint="leave out --backend batch",
        )  # fmt: skip
    if asked.verify and spec.verify_model:
        unseen = [bench.scenarios[name] for name in spec.verify_scenarios]
        require_buildable(bench, spec.verify_model, unseen, values)


def again(asked: Asked, shown: str) -> str:
    """The command once more; a password is left out of it."""
    said = {name: value for name, value in asked._asdict().items() if value != USUAL.get(name)}
    asked = Asked(**{**said, "study": shown or None})
    options = given(asked, leave=["bench", "verify"], called={"set_name": "set"})
    return pasted("tune", asked.bench, **options, no_verify=asked.verify is False)
