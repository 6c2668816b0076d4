"""A command from a function: its options are the fields of the records and the parameters that the function takes."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import NoneType
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, get_args, get_origin, get_type_hints

import typer

from tunefree_hil.base.events import Event
from tunefree_hil.cli.output import present
from tunefree_hil.jobs.options.option import DEFAULT_SESSION, Argument, Option

Record = TypeVar("Record")
StartJob = Callable[..., Iterable[Event]]


class ListedOption(NamedTuple):
    """A field of a record, or a parameter, that the command line shows."""

    name: str
    declared: Any
    default: Any = inspect.Parameter.empty

    @property
    def shown(self) -> Option | Argument:
        """What the command line shows of it."""
        return get_args(self.declared)[1]


COMMON = (
    ListedOption("plain", Annotated[bool, Option("one line an event")], False),
    ListedOption("as_json", Annotated[bool, Option("one JSON object on stdout, last", "--json")], False),
)


def command(name: str) -> Callable[[StartJob], Callable[..., int]]:
    """Make the command `name` of a function that starts a job.

    A parameter of the function whose type is a record (NamedTuple) becomes an option for each field; any other is an
    option itself. They are listed in this order, the `last` ones at the end. Their metadata is in
    jobs/options/option.py. --plain and --json are added. The function is called when the job starts, so that it may
    import the job.
    """

    def make_command(start_job: StartJob) -> Callable[..., int]:
        types = get_type_hints(start_job, include_extras=True)
        own = inspect.signature(start_job).parameters
        options = [one for parameter in own.values() for one in _list_options(parameter, types[parameter.name])]
        options.sort(key=lambda one: getattr(one.shown, "last", False))
        listed = [_make_parameter(one) for one in (*options, *COMMON)]

        def run(*, plain: bool, as_json: bool, **arguments: Any) -> int:
            given = {key: _fill_parameter(parameter, types[key], arguments) for key, parameter in own.items()}
            return present(name, lambda: start_job(**given), plain=plain, as_json=as_json)

        run.__name__, run.__doc__ = start_job.__name__, start_job.__doc__
        run.__annotations__ = {one.name: one.annotation for one in listed}
        run.__signature__ = inspect.Signature(listed)  # type: ignore[attr-defined]  # where typer reads the options
        return run

    return make_command


def session_of(session: str, join: bool) -> str:
    """The session to use; for a joined bench the default of hub, ecu and controller."""
    return session or (DEFAULT_SESSION if join else "")


def record_from(record: Callable[..., Record], arguments: Mapping[str, Any], **changes: Any) -> Record:
    """Build the options record of a job from the arguments of its command.

    Args:
        record: NamedTuple whose fields have the names of the command's arguments.
        arguments: By name, also of other records. An option that was not given (None) keeps the default of the record.
        changes: Values that replace arguments, and fields that no argument has.
    """
    fields = inspect.signature(record).parameters
    values = {name: arguments[name] for name in fields if arguments.get(name) is not None}
    return record(**{**values, **changes})


def _fill_parameter(parameter: inspect.Parameter, declared: Any, arguments: Mapping[str, Any]) -> Any:
    """The value of a parameter of the function that starts the job."""
    if _is_record(declared):
        return record_from(declared, arguments)
    value = arguments[parameter.name]
    return parameter.default if value is None else value


def _is_record(declared: Any) -> bool:
    return hasattr(declared, "_fields")


def _list_options(parameter: inspect.Parameter, declared: Any) -> list[ListedOption]:
    if not _is_record(declared):
        return [ListedOption(parameter.name, declared, parameter.default)]
    types, defaults = get_type_hints(declared, include_extras=True), declared._field_defaults
    return [ListedOption(name, types[name], defaults.get(name, inspect.Parameter.empty)) for name in types]


def _make_parameter(option: ListedOption) -> inspect.Parameter:
    """The parameter that typer reads for an option."""
    name, default, shown = option.name, option.default, option.shown
    plain = get_args(option.declared)[0]
    shown_type = _convert_type(plain, getattr(shown, "choices", ()))
    if default == ():
        shown_type, default = shown_type | None, None
    if isinstance(shown, Argument):
        info: Any = typer.Argument(metavar=shown.metavar, help=shown.help)
    else:
        names = [shown.name or f"--{name.replace('_', '-')}"] if shown.name or plain is bool else []
        info = typer.Option(*names, metavar=shown.metavar, help=shown.help, min=shown.minimum, max=shown.maximum)
    annotation = Annotated[shown_type, info]
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def _convert_type(declared: Any, choices: tuple[str, ...]) -> Any:
    """The type for typer, which has no Sequence and takes choices from a Literal."""
    parts = get_args(declared)
    if NoneType in parts:
        return _convert_type(parts[0], choices) | None
    if choices:
        return Literal[choices]
    return list[parts[0]] if get_origin(declared) is Sequence else declared
