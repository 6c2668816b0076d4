"""The learned kinds as cars: what holds for any of them, and what for each."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.effects.shared import EFFECTS, same
from tests.plant.drives import CHANNELS, DT_S, PLANTS, REST, command, drive, rest_of
from tests.plant.model_files import KINDS, MODULES, NETS, arrays_of, plant_of, without_way_out
from tunefree_hil.base.contracts import BodyChange, make_effect
from tunefree_hil.base.course import Start
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.records import GEAR_DRIVE, GEAR_NEUTRAL, GEAR_PARK, Command, Disturbance
from tunefree_hil.base.units import G_MPS2
from tunefree_hil.plant import hybrid, lstm
from tunefree_hil.plant.learned.kinematics import DEFAULTS
from tunefree_hil.plant.learned.weights_file import INPUTS, PlantFile, cell_of, save_plant
from tunefree_hil.plant.types import BodyOutput, Plant
from tunefree_hil.plant.vehicle import Body, assemble

Weave = Callable[[float], Command]
LEVEL = Disturbance()


def body_of(plant: Plant, *effects: str, **values: float) -> Body:
    """values: of every effect."""
    made = [(EFFECTS[one].port, make_effect(EFFECTS[one], values, rest=rest_of(EFFECTS[one].port))) for one in effects]
    return assemble(plant, {}, CHANNELS, effects=made)


def weave(sign: float = 1.0) -> Weave:
    return lambda t: command(0.3 if t < 2.0 else REST, REST if t < 2.5 else 0.27, sign * 3.0 * math.sin(2.0 * t))


def hybrid_of(arrays: dict[str, np.ndarray]) -> Plant:
    return hybrid.plant_of(cell_of(PlantFile("hybrid", INPUTS["hybrid"], arrays)))


@pytest.mark.parametrize("kind", KINDS)
def test_a_drive_is_finite_moves_and_hangs_together(kind: str, tmp_path: Path) -> None:
    """Position is the integral of speed and heading, heading that of yaw rate, speed that of its rate."""
    outputs = drive(body_of(plant_of(tmp_path, kind)), weave(), 6.0, start=Start(2.0, -1.0, 1.0, 8.0))
    motions = [out.motion for out in outputs]
    assert all(math.isfinite(value) for motion in motions for value in motion)
    assert all(isinstance(value, float) and not isinstance(value, np.floating) for value in motions[-1])
    for was, now in itertools.pairwise(motions):
        assert now.speed_mps >= 0.0
        assert now.speed_mps - was.speed_mps == pytest.approx(DT_S * now.speed_rate_mps2, abs=1e-12)
        mean_yaw = 0.5 * (was.yaw_rate_radps + now.yaw_rate_radps)
        assert now.heading_rad - was.heading_rad == pytest.approx(DT_S * mean_yaw, abs=1e-12)
        way_m = math.hypot(now.x_m - was.x_m, now.y_m - was.y_m)
        assert way_m == pytest.approx(DT_S * 0.5 * (was.speed_mps + now.speed_mps), rel=0.05, abs=1e-9)
    assert math.hypot(motions[-1].x_m - 2.0, motions[-1].y_m + 1.0) > 3.0


@pytest.mark.parametrize("kind", KINDS)
def test_where_it_starts_and_looks_does_not_matter(kind: str, tmp_path: Path) -> None:
    body = body_of(plant_of(tmp_path, kind))
    here = drive(body, weave(), 3.0, start=Start(speed_mps=6.0))[-1].motion
    there = drive(body, weave(), 3.0, start=Start(10.0, -4.0, 1.0, 6.0))[-1].motion
    cosine, sine = math.cos(1.0), math.sin(1.0)
    assert there.x_m == pytest.approx(10.0 + here.x_m * cosine - here.y_m * sine)
    assert there.y_m == pytest.approx(-4.0 + here.x_m * sine + here.y_m * cosine)
    assert there.yaw_rate_radps == pytest.approx(here.yaw_rate_radps, abs=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_two_drives_of_one_body_do_not_meet(kind: str, tmp_path: Path) -> None:
    """Buffers belong to the state, not to the plant."""
    body = body_of(plant_of(tmp_path, kind))
    once = drive(body, weave(), 2.0, start=Start(speed_mps=7.0))
    assert drive(body, weave(), 2.0, start=Start(speed_mps=7.0)) == once


@pytest.mark.parametrize("kind", NETS)
def test_no_weights_do_more_than_the_bound_says(kind: str, tmp_path: Path) -> None:
    body = body_of(plant_of(tmp_path, kind, size=50.0))
    outputs = drive(body, weave(), 5.0, start=Start(speed_mps=15.0))
    physics = drive(body_of(PLANTS["physics"]), weave(), 5.0, start=Start(speed_mps=15.0))
    bound = arrays_of(kind)["bound"]
    most = max(abs(out.motion.speed_rate_mps2) for out in outputs)
    own = max(abs(out.motion.speed_rate_mps2) for out in physics) + 1.0 if kind == "hybrid" else 0.0
    assert most <= bound[0] + own + 1e-9
    assert all(math.isfinite(out.motion.x_m) for out in outputs)


def test_a_hybrid_that_corrects_nothing_is_the_single_track_car() -> None:
    """Bit for bit (-0.0 equals 0.0), stops and a hill among it."""
    still = body_of(hybrid_of(without_way_out(arrays_of("hybrid"))))
    plain = body_of(PLANTS["physics"])

    def stops(t: float) -> Command:
        return command(0.35 if t < 1.0 else REST, 0.3 if 2.0 < t < 6.0 else REST, 4.0 * math.sin(t))

    for start in (Start(speed_mps=9.0), Start(), Start(1.0, 2.0, 0.5, 0.4)):
        for road in (Disturbance(), Disturbance(0.05, 0.4, -0.04, 0.6)):
            assert drive(still, stops, 8.0, start=start, road=road) == drive(plain, stops, 8.0, start=start, road=road)


def test_a_hybrid_without_a_residual_mirrors() -> None:
    still = body_of(hybrid_of(without_way_out(arrays_of("hybrid"))))
    for left, right in zip(
        drive(still, weave(), 4.0, start=Start(speed_mps=9.0)),
        drive(still, weave(-1.0), 4.0, start=Start(speed_mps=9.0)),
        strict=True,
    ):
        assert left.motion.y_m == pytest.approx(-right.motion.y_m, abs=1e-9)
        assert left.motion.speed_mps == pytest.approx(right.motion.speed_mps, abs=1e-9)


def test_a_residual_is_what_it_says() -> None:
    """A constant residual of acceleration and yaw rate: speed grows by it, and the rear axle does not slide."""
    arrays = without_way_out(arrays_of("hybrid"))
    arrays["b_out"] = np.arctanh(np.array([0.2, 0.03]) / arrays["bound"])
    rolling = lambda t: command(0.2)  # noqa: E731
    ours = drive(body_of(hybrid_of(arrays)), rolling, 1.0, start=Start(speed_mps=10.0))
    plain = drive(body_of(PLANTS["physics"]), rolling, 1.0, start=Start(speed_mps=10.0))
    assert ours[1].motion.speed_mps - plain[1].motion.speed_mps == pytest.approx(0.002, abs=1e-8)
    assert ours[-1].motion.yaw_rate_radps == pytest.approx(0.03, abs=1e-6)
    for out in ours[1:]:
        rear_mps = out.motion.side_speed_mps - 1.4224 * out.motion.yaw_rate_radps
        assert rear_mps == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("kind", ["hybrid", "rule_based"])
@pytest.mark.parametrize("grade", [0.0, -0.05])
def test_stop_means_stop(kind: str, grade: float, tmp_path: Path) -> None:
    outputs = drive(
        body_of(plant_of(tmp_path, kind)), lambda t: command(REST, 0.32, 1.0), 8.0,
        start=Start(speed_mps=6.0), road=Disturbance(grade),
    )  # fmt: skip
    stopped = [k for k, out in enumerate(outputs) if out.motion.speed_mps == 0.0]
    assert stopped, "it stops"
    last = outputs[-1].motion
    for out in outputs[stopped[0] + 1 :]:
        motion = out.motion
        assert (motion.speed_mps, motion.side_speed_mps, motion.yaw_rate_radps) == (0.0, 0.0, 0.0)
        assert (motion.x_m, motion.y_m) == pytest.approx((last.x_m, last.y_m), abs=1e-9)


@pytest.mark.parametrize("kind", ["lstm", "mlp"])
def test_a_network_that_asks_for_next_to_nothing_does_not_move_a_standing_car(kind: str, tmp_path: Path) -> None:
    arrays = without_way_out(arrays_of(kind))
    name = "b2" if kind == "mlp" else "b_out"
    arrays[name] = np.array([0.05 / 6.0, 0.3])
    save_plant(tmp_path / "plant.npz", kind, arrays)
    opener = MODULES[kind].PLANT.open
    assert opener is not None
    body = body_of(opener(tmp_path / "plant.npz"))
    assert drive(body, weave(), 1.0)[-1].motion.x_m == 0.0
    assert drive(body, weave(), 1.0, start=Start(speed_mps=3.0))[-1].motion.speed_mps > 3.0


def last(plant: Plant, *effects: str, road: Disturbance = LEVEL, **values: float) -> BodyOutput:
    body = body_of(plant, *effects, **values)
    return drive(body, lambda t: command(0.22), 1.0, start=Start(speed_mps=10.0), road=road)[-1]


def test_what_acceleration_can_show_is_shown(tmp_path: Path) -> None:
    """Grade, mass and a dragging brake on a plant that knows nothing of them; the map's is memoryless, so exact."""
    plant = plant_of(tmp_path, "rule_based")
    plain = last(plant).motion
    rate = plain.speed_rate_mps2
    hill = last(plant, "grade", grade_rad=0.04).motion
    assert plain.speed_mps - hill.speed_mps == pytest.approx(G_MPS2 * math.sin(0.04), rel=0.05)
    assert last(plant, road=Disturbance(0.04)).motion == hill
    heavy = last(plant, "payload", mass_kg=2080.0).motion
    rolls = DEFAULTS["rolling_frac"] * G_MPS2  # as much for a heavier car; all else is halved
    assert heavy.speed_rate_mps2 == pytest.approx(0.5 * (rate + rolls) - rolls, rel=0.06)
    drag = last(plant, "brake_drag", force_n=2080.0).motion
    assert plain.speed_mps - drag.speed_mps == pytest.approx(1.0, rel=0.05)
    rolling = last(plant, "rolling_resistance", extra_frac=2.0).motion
    assert plain.speed_mps - rolling.speed_mps == pytest.approx(2.0 * DEFAULTS["rolling_frac"] * G_MPS2, rel=0.05)


@pytest.mark.parametrize("kind", KINDS)
def test_a_banked_road_in_the_wind_moves_the_car_where_there_is_physics(kind: str, tmp_path: Path) -> None:
    """Without physics the axle holds: the path is the same, and the accelerometer feels the bank, not the wind."""
    plant = plant_of(tmp_path, kind)
    level, banked, windy = (
        last(plant, road=road).motion for road in (LEVEL, Disturbance(bank_rad=0.04), Disturbance(side_wind_mps2=0.6))
    )
    if kind == "hybrid":
        assert banked.y_m < level.y_m - 0.01 and windy.y_m > level.y_m + 0.01
        return
    assert windy == level and banked[:7] == level[:7]
    felt = banked.lateral_accel_mps2 - level.lateral_accel_mps2
    assert felt == pytest.approx(G_MPS2 * math.sin(0.04))


@pytest.mark.parametrize(("gear", "moves"), [(GEAR_PARK, False), (GEAR_NEUTRAL, False), (GEAR_DRIVE, True)])
def test_only_in_drive_it_creeps(gear: float, moves: bool, tmp_path: Path) -> None:
    body = body_of(plant_of(tmp_path, "rule_based"))
    assert (drive(body, lambda t: command(gear=gear), 3.0)[-1].motion.x_m > 0.0) == moves


def test_air_is_acceleration_too(tmp_path: Path) -> None:
    """More area, and wind: what is more than the drag that the map has in it comes on top."""
    plant = plant_of(tmp_path, "rule_based")
    was, mass_kg, area_m2 = 10.0, DEFAULTS["mass_kg"], DEFAULTS["drag_area_m2"]

    def slowed(*effects: str, **values: float) -> float:
        body = [body_of(plant, *names, **values if names else {}) for names in ((), effects)]
        rates = [drive(one, lambda t: command(0.22), 0.01, start=Start(speed_mps=was))[-1].motion for one in body]
        return rates[0].speed_rate_mps2 - rates[1].speed_rate_mps2

    assert slowed("aero_drag", drag_area_m2=2.0) == pytest.approx(0.5 * 1.2 * 2.0 * was**2 / mass_kg, rel=1e-6)
    wind = 0.5 * 1.2 * area_m2 / mass_kg * ((was + 8.0) ** 2 - was**2)
    assert slowed("head_wind", wind_mps=8.0) == pytest.approx(wind, rel=1e-6)
    behind = 0.5 * 1.2 * area_m2 / mass_kg * (-((was - 18.0) ** 2) - was**2)
    assert slowed("head_wind", wind_mps=-18.0) == pytest.approx(behind, rel=1e-6)


@pytest.mark.parametrize("kind", ["lstm", "mlp", "paper", "rule_based"])
@pytest.mark.parametrize(
    ("effect", "values"),
    [
        ("power_limit", {"power_w": 3.0e4}),
        ("brake_fade", {"loss_per_mj": 0.1}),
        ("payload", {"mass_kg": 100.0, "ahead_m": 0.5}),
        ("front_stiffness", {"gain_frac": 0.9}),
        ("rear_stiffness", {"gain_frac": 0.9}),
        ("tyre_relaxation", {"length_m": 0.5}),
        ("side_wind", {"force_n": 100.0}),
        ("road_bank", {"bank_rad": 0.02}),
    ],
)
def test_what_it_cannot_show_is_refused(kind: str, effect: str, values: dict[str, float], tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        body_of(plant_of(tmp_path, kind), effect, **values)
    assert caught.value.code == "not_in_this_plant" and effect in caught.value.message and kind in caught.value.message


@pytest.mark.parametrize("kind", KINDS)
def test_effects_of_its_physics_are_the_hybrids(kind: str, tmp_path: Path) -> None:
    """All that the catalogue has is taken by a hybrid; neutral, every kind takes all of it and is the same."""
    plant = plant_of(tmp_path, kind)
    neutral = assemble(
        plant, {}, CHANNELS,
        effects=[(one.port, make_effect(one, {}, rest=rest_of(one.port))) for _, one in sorted(EFFECTS.items())],
    )  # fmt: skip
    with_them, without = (drive(body, weave(), 1.0, start=Start(speed_mps=8.0)) for body in (neutral, body_of(plant)))
    assert same(with_them, without)


@pytest.mark.parametrize("kind", KINDS)
def test_measured_motion_can_be_put_in(kind: str, tmp_path: Path) -> None:
    """Pose, speed and yaw rate are the measured ones, what the plant remembers goes on; the next tick starts there."""
    plant = plant_of(tmp_path, kind)
    body = body_of(plant)
    assert plant.observe is not None
    block = plant.make({}, BodyChange())
    state = block.init(block.params, DT_S)
    seen = drive(body, weave(), 1.0, start=Start(3.0, 4.0, 0.5, 9.0))[-1].motion
    observed = plant.observe(state, seen)
    motion = observed if kind == "rule_based" else observed.motion
    assert motion[:4] == seen[:4] and motion.yaw_rate_radps == seen.yaw_rate_radps
    assert type(observed) is type(state)


@pytest.mark.parametrize("kind", KINDS)
def test_a_kind_without_its_file_says_so(kind: str) -> None:
    with pytest.raises(InputError) as caught:
        assemble(MODULES[kind].PLANT, {}, CHANNELS)
    assert caught.value.code == "no_plant_file" and caught.value.key == "plant.file"


@pytest.mark.parametrize("kind", KINDS)
def test_an_unknown_parameter_is_named(kind: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="wings"):
        assemble(plant_of(tmp_path, kind), {"wings": 2.0}, CHANNELS)


def test_an_lstm_that_says_nothing_rolls_on() -> None:
    net = cell_of(PlantFile("lstm", INPUTS["lstm"], without_way_out(arrays_of("lstm"))))
    last = drive(body_of(lstm.plant_of(net)), weave(), 2.0, start=Start(speed_mps=5.0))[-1].motion
    assert (last.x_m, last.y_m, last.speed_mps) == pytest.approx((10.0, 0.0, 5.0))


@pytest.mark.parametrize("way", [1.0, 0.9])
def test_what_comes_on_top_is_not_gone_on_with_by_a_net_that_knows_its_last_acceleration(
    way: float, tmp_path: Path
) -> None:
    """A net that says again what it took in (or most of it): gravity adds up once a tick, not once more each tick."""
    arrays = {name: np.zeros_like(value) for name, value in arrays_of("mlp").items()}
    arrays |= {"scale": np.ones(6), "bound": np.array([600.0, 1.0])}  # so wide that tanh is a line
    arrays["w1"][0, 4], arrays["w2"][0, 0] = 1e-3, way * 1e3 / 600.0
    save_plant(tmp_path / "plant.npz", "mlp", arrays)
    opener = MODULES["mlp"].PLANT.open
    assert opener is not None
    uphill = drive(body_of(opener(tmp_path / "plant.npz")), lambda t: command(), 2.0, start=Start(speed_mps=10.0),
                   road=Disturbance(0.02))[-1].motion  # fmt: skip
    assert 10.0 - uphill.speed_mps == pytest.approx(2.0 * G_MPS2 * math.sin(0.02), rel=0.02)
