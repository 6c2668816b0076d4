"""Cars and drives that the plant's tests share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from tunefree_hil.base.contracts import Effect, Port, make_effect
from tunefree_hil.base.course import Start
from tunefree_hil.base.records import GEAR_DRIVE, NAN, Command, Disturbance
from tunefree_hil.plant import reference, single_track
from tunefree_hil.plant.actuation.actuators import ActuatorParams
from tunefree_hil.plant.types import BodyInput, BodyOutput, Driver
from tunefree_hil.plant.vehicle import Body, assemble, first_output, for_episode

DT_S = 0.01
REST = 0.15
PLANTS = {"physics": single_track.PLANT, "reference": reference.PLANT}
CHANNELS = {
    "throttle": ActuatorParams(dead_time_s=0.03, rest=REST, initial=REST),
    "brake": ActuatorParams(rest=REST, initial=REST),
    "steer": ActuatorParams(dead_time_s=0.1, lag_s=0.0773, rate_limit=8.55211),
}


def car(
    kind: str,
    params: Mapping[str, float] | None = None,
    effects: tuple[tuple[Effect, dict[str, float]], ...] = (),
    *,
    substeps: int = 0,
    ins_latency_s: float = 0.0,
    dt_s: float = DT_S,
) -> Body:
    """An assembled vehicle; `substeps` other than the plant's own when it is not 0."""
    plant = PLANTS[kind]._replace(substeps=substeps or PLANTS[kind].substeps)
    made: list[tuple[Port, Any]] = [
        (effect.port, make_effect(effect, values, rest=rest_of(effect.port))) for effect, values in effects
    ]
    return assemble(plant, params or {}, CHANNELS, effects=made, ins_latency_s=ins_latency_s, dt_s=dt_s)


def rest_of(port: Port) -> float:
    """A port's value with nobody asking for anything."""
    return REST if port.value.split()[0] in ("throttle", "brake") else 0.0


def command(throttle: float = REST, brake: float = REST, steer: float = 0.0, gear: float = GEAR_DRIVE) -> Command:
    return Command(throttle, brake, steer, gear, NAN, NAN)


def drive(
    body: Body,
    commands: Callable[[float], Command],
    duration_s: float,
    *,
    start: Start = Start(),  # noqa: B008 - a frozen record
    road: Disturbance = Disturbance(),  # noqa: B008 - a frozen record
    noise: Any = None,
    dt_s: float = DT_S,
) -> list[BodyOutput]:
    """Outputs of ticks 0..n; `commands` is asked with the time of the tick's beginning."""
    body = for_episode(body, start, noise)
    state, out = first_output(body, dt_s)
    outputs = [out]
    for k in range(round(duration_s / dt_s)):
        state, out = body.block.step(body.block.params, state, BodyInput(commands(k * dt_s), Driver(), road), dt_s)
        outputs.append(out)
    return outputs
