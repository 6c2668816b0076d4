"""Checks a vehicle.toml by itself and lists all problems; against its DBC: bus/dbc/check_vehicle.py."""

from __future__ import annotations

from pathlib import Path

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.records import GROUPS, WHEEL_FIELDS
from tunefree_hil.config.find import nearest
from tunefree_hil.config.problem import ConfigProblem, Problems
from tunefree_hil.config.schema import FieldSpec, VehicleSpec
from tunefree_hil.config.vehicle_numbers import check_numbers

WHEELS = "wheel_speed_radps"
CONDITIONS = (
    *("enabled", "override", "driver", "fault", "timeout", "watchdog", "e2e"),
    *("brake_light", "gear_command", "gear_reject"),
)
# The causes of a condition; of the others: plant/actuation/bywire_types.py, and names of the folder.
STATE_CAUSES = {
    "e2e": ("", "some_lost", "repeated", "wrong_sequence", "wrong_crc", "no_new_data", "initial"),
    "brake_light": ("input", "command", "output"),
    "gear_command": ("park", "reverse", "neutral", "drive", "low"),
    "gear_reject": ("override", "vehicle"),
}
ACTUATORS = ("throttle", "brake", "steer", "gear", "accel", "steer_torque")
# Alternative command sets (docs/reference/files.md): the one in use counts, its echoes in the reports too.
PEDALS = ("throttle_frac", "brake_frac")
ECHOES = {
    "throttle_input_frac": "throttle_frac",
    "throttle_command_frac": "throttle_frac",
    "throttle_frac": "throttle_frac",
    "brake_input_frac": "brake_frac",
    "brake_command_frac": "brake_frac",
    "brake_frac": "brake_frac",
    "steer_command_rad": "steer_rad",
    "accel_command_mps2": "accel_mps2",
    "steer_torque_command_nm": "steer_torque_nm",
    "steer_torque_nm": "steer_torque_nm",
}
MOST_MS = 3_600_000  # an hour: a period or time-out above it is a mistake


def field_names(group: str) -> list[str]:
    """The names that tables [group.*] may have."""
    names = [name for name in GROUPS[group]._fields if name not in WHEEL_FIELDS]
    return [*names, WHEELS] if group == "report" else names


def check_fields(spec: VehicleSpec) -> list[InputError]:
    """Every problem of the file by itself."""
    file = str(Path(spec.folder) / "vehicle.toml")
    return [
        InputError(message, code="vehicle", file=file, key=key, hint=hint)
        for check in (check_numbers, _names, _periods, _presence, _states)
        for key, message, hint in check(spec)
    ]


def _names(spec: VehicleSpec) -> Problems:
    if not spec.dbc:
        yield ConfigProblem("dbc", "it is empty", "name the DBC files of the folder")
    for name in spec.latency:
        if name not in ACTUATORS:
            yield ConfigProblem(f"latency.{name}", "no such actuator", nearest(name, ACTUATORS))
    for group in GROUPS:
        for name, field in getattr(spec, group).items():
            key = f"{group}.{name}"
            if name not in field_names(group):
                yield ConfigProblem(key, "no such record field", nearest(name, field_names(group)))
            yield from _signals(key, name, field)
    known = [f"{group}.{name}" for group in GROUPS for name in field_names(group)]
    for i, name in enumerate(spec.absent):
        if name not in known:
            yield ConfigProblem(f"absent[{i}]", f"no such record field: {name!r}", nearest(name, known))


def _signals(key: str, name: str, field: FieldSpec) -> Problems:
    listed = isinstance(field.signal, list)
    if bool(field.signal) == bool(field.signals):
        yield ConfigProblem(
            f"{key}.signal",
            "expected either `signal` or `signals`",
            'signal = "NAME", or signals = [{ name = "A" }, ...]',
        )
    if name == WHEELS and (not listed or len(field.signal) != 4):
        yield ConfigProblem(f"{key}.signal", "expected four signals", 'signal = ["FL", "FR", "RL", "RR"]')
    if name != WHEELS and listed:
        yield ConfigProblem(
            f"{key}.signal", "expected one signal, got a list", "a sum is written signals = [{ name, scale }, ...]"
        )
    if field.scale == 0.0 or any(term.scale == 0.0 for term in field.signals):
        yield ConfigProblem(f"{key}.scale", "it is 0", "SI value = physical value * scale + offset")
    if field.specific_force and key != "ins.accel_mps2":
        yield ConfigProblem(
            f"{key}.specific_force", "only [ins.accel_mps2] may have it", "reports are specific force anyway"
        )


def _periods(spec: VehicleSpec) -> Problems:
    tick = max(spec.tick_ms, 1)
    entries = [(f"{group}.{name}", field) for group in GROUPS for name, field in getattr(spec, group).items()]
    for key, entry in [*entries, *((f"extra.{name}", extra) for name, extra in spec.extra.items())]:
        period = entry.period_ms
        if period <= 0 or period % tick:
            hint = f"give a whole multiple of tick_ms = {spec.tick_ms}, or a tick that divides it"
            yield ConfigProblem(
                f"{key}.period_ms", f"{period} is no multiple of the tick" if period > 0 else f"it is {period}", hint
            )
        elif period > MOST_MS:
            yield ConfigProblem(f"{key}.period_ms", f"{period} is above {MOST_MS}", "give milliseconds")
    for key, field in entries:
        if field.timeout_ms < 0 or field.timeout_ms % tick:
            yield ConfigProblem(
                f"{key}.timeout_ms", f"{field.timeout_ms} is no multiple of the tick", f"tick_ms = {spec.tick_ms}"
            )
        elif field.timeout_ms > MOST_MS:
            yield ConfigProblem(f"{key}.timeout_ms", f"{field.timeout_ms} is above {MOST_MS}", "give milliseconds")


def _presence(spec: VehicleSpec) -> Problems:
    """Each field is either mapped or listed as absent."""
    for group in GROUPS:
        mapped = getattr(spec, group)
        for name in field_names(group):
            key = f"{group}.{name}"
            if name in mapped and key in spec.absent:
                yield ConfigProblem(key, "it is mapped and listed in `absent`", "remove one")
            elif name not in mapped and key not in spec.absent and _counts(spec, group, name):
                yield ConfigProblem(key, "neither mapped nor listed in `absent`", f'add [{key}], or "{key}" to absent')


def _counts(spec: VehicleSpec, group: str, name: str) -> bool:
    """Whether a field that is not mapped is missed: of alternative command sets only the one in use counts."""
    if group == "command":
        return name in _commands_in_use(spec)
    if group == "report" and name in ECHOES:
        return ECHOES[name] in spec.command
    return True


def _commands_in_use(spec: VehicleSpec) -> set[str]:
    absent = {key.removeprefix("command.") for key in spec.absent if key.startswith("command.")}
    listed = spec.command.keys() | absent
    used = {"gear"}
    if not (listed & {"accel_mps2"}) or spec.command.keys() & set(PEDALS):
        used.update(PEDALS)
    if not listed & {"steer_torque_nm"}:
        used.add("steer_rad")
    return used


def _states(spec: VehicleSpec) -> Problems:
    for condition, states in spec.state.items():
        if condition not in CONDITIONS:
            yield ConfigProblem(f"state.{condition}", "no such condition", nearest(condition, CONDITIONS))
        for i, state in enumerate(states):
            if not state.message or not state.signal:
                yield ConfigProblem(f"state.{condition}[{i}]", "message and signal are needed", "name both")
            known = STATE_CAUSES.get(condition)
            if known is not None and state.cause not in known:
                yield ConfigProblem(
                    f"state.{condition}[{i}].cause", f"no cause {state.cause!r}", nearest(state.cause, known)
                )
