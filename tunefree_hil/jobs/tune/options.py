"""The options of `tune`, as given and as resolved; all checks are made before a process starts."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import Bench, load, parameters_of, require_buildable
from tunefree_hil.bench.user_kernels import require_kernel_parts
from tunefree_hil.control.parameters import BoxChoice
from tunefree_hil.grade.objectives import choose_objectives
from tunefree_hil.grade.requirements.limits import RequirementLimits, requirement_limits, search_limits
from tunefree_hil.jobs.command_text import changed_options, shell_command
from tunefree_hil.jobs.drive import new_session_name
from tunefree_hil.jobs.identity import compute_identity
from tunefree_hil.jobs.options.records import BATCH, BUS, TuneOptions
from tunefree_hil.jobs.run_folder import open_run
from tunefree_hil.jobs.running.foreign import require_foreign_controller, with_controller_command
from tunefree_hil.jobs.running.node_links import resolve_vehicle_bus
from tunefree_hil.jobs.running.session import choose_lane_count
from tunefree_hil.jobs.tune.candidates import compute_baseline_vectors, has_foreign_controller, select_first_vector
from tunefree_hil.tune.baselines import list_further_starts, make_first_trial
from tunefree_hil.tune.sampling import AUTO
from tunefree_hil.tune.sampling.automatic_choice import (
    SamplerChoice,
    SearchTask,
    choose_sampler,
    describe_choice,
)
from tunefree_hil.tune.shared.server import parse_address
from tunefree_hil.tune.space import Space, resolve_space
from tunefree_hil.tune.store import REQUIREMENTS, StudySettings, check_settings

OPTIONS = "options"  # key of run.json
BATCH_IN_FLIGHT = 8  # does not make the result worse (docs/reference/design.md)
SHARED_IN_FLIGHT = 0  # each worker takes a slot when it is free
DEFAULTS: Mapping[str, Any] = {"scale": "log", "verify": True, "confirm": 3}
MAX_SLOWER_FACTOR = 10.0  # larger values are typing errors


class TunePlan(NamedTuple):
    """The resolved options.

    bench_file: The given one, or the copy in the run to resume.
    vectors: Baselines by name.
    study_address: Of a shared study, without the password; '' for a study in the run folder.
    command: The same command again, for a shell.
    sampler_choice: How `auto` was resolved; None where the sampler was named, or the run that is resumed has it.
    """

    options: TuneOptions
    bench_file: Path
    bench: Bench
    settings: StudySettings
    identity: dict[str, Any]
    vectors: dict[str, dict[str, float]]
    trials: int
    benches: int
    session: str
    study_address: str
    command: str
    sampler_choice: SamplerChoice | None = None

    @property
    def run_record(self) -> dict[str, Any]:
        """The part of run.json that must agree for an unfinished run to be continued."""
        options = self.options
        return {
            "command": "tune",
            "identity": self.identity["identity"],
            "settings": self.settings.as_data(),
            "backend": options.backend,
            "realtime": options.realtime,
            "study": self.study_address,
        }

    @property
    def confirm(self) -> int:
        """How many trials of a batch are driven again over the bus."""
        return int(self.options.confirm or DEFAULTS["confirm"])

    @property
    def sampler_text(self) -> str:
        """How `auto` was resolved, in words; '' where it was not."""
        if self.sampler_choice is None:
            return ""
        return describe_choice(self.sampler_choice, _search_task(self.options, self.settings, self.trials))

    @property
    def stored_options(self) -> dict[str, Any]:
        """The options in run.json that `--resume` keeps where the command does not give them."""
        options, settings = self.options, self.settings
        return {
            "trials": self.trials,
            "set_name": options.set_name,
            "sampler": settings.sampler,
            "seed": settings.seed,
            "scale": options.scale,
            "verify": options.verify,
            "confirm": options.confirm,
            **({"objectives": options.objectives} if options.objectives else {}),
        }


def make_tune_plan(options: TuneOptions) -> TunePlan:
    """Resolve and check the options. Raises InputError."""
    bench_file = _find_bench_file(options)
    options = fill_defaults(_restore_options(options) if options.resume else options)
    bench = with_controller_command(load(bench_file), options.controller)
    options = _choose_backend(bench, options)
    _require_compatible(options)
    address = parse_address(options.study) if options.study else None
    _require_slower(bench)
    _require_batch_for_ensemble(bench, options)
    space = _space(bench, options)
    _require_buildable(bench, options, space)
    session = options.session or new_session_name()
    resolve_vehicle_bus(bench, options.bus, session, options.bench_bus)
    vectors = compute_baseline_vectors(bench)
    require_foreign_controller(bench, space.names, join=options.join)
    identity = compute_identity(bench, bench.spec.model, [bench.scenarios[name] for name in bench.spec.scenarios])
    benches = _benches(options)
    trials = options.trials or bench.spec.tune.trials
    settings = _study_settings(bench, options, space, vectors, identity["identity"])
    choice = choose_sampler(_search_task(options, settings, trials)) if settings.sampler == AUTO else None
    settings = settings._replace(sampler=choice.sampler if choice else settings.sampler)
    check_settings(settings)  # before there is a run folder, which could not be resumed
    study_address = f"{address.public}#{address.name}" if address else ""
    return TunePlan(
        options=options,
        bench_file=bench_file,
        bench=bench,
        settings=settings,
        identity=identity,
        vectors=vectors,
        trials=trials,
        benches=benches,
        session=session,
        study_address=study_address,
        command=format_command(options._replace(bench=bench_file), study_address),
        sampler_choice=choice,
    )


def _study_settings(
    bench: Bench, options: TuneOptions, space: Space, vectors: Mapping[str, Mapping[str, float]], identity: str
) -> StudySettings:
    first = make_first_trial(space, select_first_vector(vectors))
    return StudySettings(
        space=space,
        seed=bench.spec.seed if options.seed is None else options.seed,
        sampler=options.sampler or bench.spec.tune.sampler,
        bench_hash=identity,
        first=first,
        in_flight=_in_flight(bench, options, _benches(options)),
        requirements=_requirements(bench, options),
        starts=list_further_starts(space, vectors, first) if bench.spec.tune.starts == "manual" else (),
        objectives=_objectives(bench, options),
        kappa_w=bench.spec.tune.kappa_w,
    )


def _search_task(options: TuneOptions, settings: StudySettings, trials: int) -> SearchTask:
    """What `auto` chooses by. The same for all workers of a shared study."""
    return SearchTask(
        trials=trials,
        parameters=len(settings.space.axes),
        objectives=max(1, len(settings.objectives)),
        is_batch=options.backend == BATCH,
        has_requirements=bool(settings.requirements),
    )


def _objectives(bench: Bench, options: TuneOptions) -> tuple[str, ...]:
    """The objectives of the search: those of the command, else of the bench file; empty for the score alone."""
    named = options.objectives.split(",") if options.objectives else bench.spec.tune.objectives
    return choose_objectives([] if named == ["score"] else named, bench.weights, bench.file)


def _find_bench_file(options: TuneOptions) -> Path:
    """The bench file that was given, or the copy in the run to resume. Raises InputError without either."""
    if options.bench is not None:
        return options.bench
    if options.resume is not None:
        return options.resume / "bench.toml"
    benches = sorted(Path("bench_configs").glob("*.toml"))
    listed = ", ".join(str(path) for path in benches) or "bench_configs/NAME.toml"
    raise InputError("no bench file given", code="usage", key="BENCH", hint=f"give one of {listed}, or --resume RUN")


def _restore_options(options: TuneOptions) -> TuneOptions:
    """The options of a resumed run: those of the command, then those that the run was started with.

    A run of an earlier version has no `options` in run.json.
    """
    record = _read_tune_record(options.resume) if options.resume else {}
    not_given, settings = TuneOptions._field_defaults, record.get("settings", {})
    stored = {"sampler": settings.get("sampler"), **record.get(OPTIONS, {})}
    return options._replace(
        **{name: value for name, value in stored.items() if getattr(options, name) == not_given[name]},
        backend=record.get("backend", options.backend),
        realtime=record.get("realtime", options.realtime),
        in_flight=settings.get("in_flight", options.in_flight),
    )


def fill_defaults(options: TuneOptions) -> TuneOptions:
    """The options with DEFAULTS for those that were not given."""
    return options._replace(**{name: value for name, value in DEFAULTS.items() if getattr(options, name) is None})


def _read_tune_record(path: Path) -> dict[str, Any]:
    """Read run.json of a tune. Raises InputError for any other run, whose episodes would be overwritten."""
    record = open_run(path).record
    command = record.get("command")
    if command != "tune":
        hint = "give the run folder of a tune, or leave --resume out for a new run"
        message = f"is a run of {command!r}: there is no search to resume"
        raise InputError(message, code="not_a_tune", file=str(path), key="--resume", hint=hint)
    return record


def _space(bench: Bench, options: TuneOptions) -> Space:
    tune = bench.spec.tune
    specs = [] if options.set_name else tune.parameters
    name = options.set_name or tune.set
    scale = "" if options.scale == "log" else options.scale or ""
    return resolve_space(name, specs, scale=scale, box=choose_box(bench), file=bench.file)


def choose_box(bench: Bench) -> BoxChoice:
    """The box of the bench file; without a choice the wider one where its requirements hold it in check."""
    without_choice = BoxChoice.DEFAULT if bench.spec.require is not None else BoxChoice.PAPER
    return BoxChoice(bench.spec.tune.box or without_choice)


def _choose_backend(bench: Bench, options: TuneOptions) -> TuneOptions:
    """The options with a backend: as given, else that of the bench file, unless only the bus can do what is asked."""
    needs_bus = options.realtime or options.study or options.join or bench.spec.controller.command
    return options._replace(backend=options.backend or (BUS if needs_bus else bench.spec.tune.backend))


def _require_compatible(options: TuneOptions) -> None:
    """Raise InputError for two options that exclude each other."""
    is_given = {
        "--backend batch": options.backend == BATCH,
        "--study": bool(options.study),
        "--join": options.join,
        "--benches": options.benches > 1,
        "--realtime": options.realtime,
        "--controller": bool(options.controller),
        "--bus": options.bus not in ("auto", "tfhub"),
    }
    reasons = {
        ("--backend batch", "--realtime"): "the batch does not run in real time",
        ("--backend batch", "--study"): "the batch is one process; workers share a study over the bus",
        ("--backend batch", "--controller"): "the batch has only our controller",
        ("--join", "--benches"): "there is one bench to join",
        ("--join", "--realtime"): "the timing of joined nodes cannot be checked",
        ("--join", "--controller"): "the controller of a joined bench runs already",
        ("--bus", "--benches"): "each bench has a hub of its own",
    }
    for (first, second), reason in reasons.items():
        if is_given[first] and is_given[second]:
            hint = f"leave out {first} or {second}"
            raise InputError(f"{first} and {second}: {reason}", code="usage", key=second, hint=hint)


def _benches(options: TuneOptions) -> int:
    """Number of benches side by side; in real time one, which needs the whole machine."""
    return options.benches or (1 if options.realtime else choose_lane_count(options.join, options.bus))


def _in_flight(bench: Bench, options: TuneOptions, benches: int) -> int:
    """Number of trials in a generation: enough to keep every bench busy."""
    if options.study:
        return SHARED_IN_FLIGHT
    in_flight = options.in_flight or bench.spec.tune.in_flight
    if options.backend == BATCH:
        return in_flight or BATCH_IN_FLIGHT
    return in_flight or -(-benches // len(bench.spec.scenarios))


def _requirements(bench: Bench, options: TuneOptions) -> RequirementLimits:
    """Limits that the search keeps; none in a resumed study that was started without, by an earlier version."""
    if options.resume is not None and REQUIREMENTS not in _read_tune_record(options.resume).get("settings", {}):
        return {}
    return search_limits(requirement_limits(bench.vehicle.limits, bench.spec.require))


def _require_batch_for_ensemble(bench: Bench, options: TuneOptions) -> None:
    if bench.spec.ensemble is not None and options.backend != BATCH:
        message, hint = "only the batch drives an ensemble of cars", "add --backend batch, or leave out [ensemble]"
        raise InputError(message, code="usage", file=bench.file, key="ensemble", hint=hint)


def _require_slower(bench: Bench) -> None:
    slower = bench.spec.tune.slower
    if not 1.0 <= slower <= MAX_SLOWER_FACTOR:
        hint = f"from 1 (no robustness check) to {MAX_SLOWER_FACTOR:g}; default: 1.5"
        message = f"{slower:g} is not allowed"
        raise InputError(message, code="bad_slower", file=bench.file, key="tune.slower", hint=hint)


def _require_buildable(bench: Bench, options: TuneOptions, space: Space) -> None:
    """Raise InputError for a model, controller or scenario that a node could not build, before the search starts.

    MRAC is on in the check where it is tuned, or where baselines are driven, since some of them have it on.
    """
    values, spec = parameters_of(bench), bench.spec
    if not has_foreign_controller(bench) or any(name.startswith("mrac.") for name in space.names):
        values["mrac.enable"] = 1.0
    scenarios = [bench.scenarios[name] for name in spec.scenarios]
    require_buildable(bench, spec.model, scenarios, values, realtime=options.realtime)
    if options.backend == BATCH:
        require_kernel_parts(bench)
    if options.backend == BATCH and spec.controller.command:
        message, hint = "the batch has only our controller", "leave out --backend batch"
        raise InputError(message, code="usage", file=bench.file, key="controller.command", hint=hint)
    if options.verify and spec.verify_model:
        verify_scenarios = [bench.scenarios[name] for name in spec.verify_scenarios]
        require_buildable(bench, spec.verify_model, verify_scenarios, values)


def format_command(options: TuneOptions, study_address: str) -> str:
    """The same command again, without the password of a shared study."""
    set_options = {name: value for name, value in options._asdict().items() if value != DEFAULTS.get(name)}
    shown = TuneOptions(**{**set_options, "study": study_address or None})
    words = changed_options(shown, skip=["bench", "verify"], option_names={"set_name": "set"})
    return shell_command("tune", shown.bench, **words, no_verify=shown.verify is False)
