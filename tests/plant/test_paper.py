"""Kind `paper`: windows over time, commands in."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from tests.plant.drives import CHANNELS, DT_S, REST, command, drive
from tests.plant.learned.test_lstm_cell import by_numpy
from tests.plant.model_files import arrays_of, plant_of
from tunefree_hil.base.course import Start
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.records import Command
from tunefree_hil.plant.paper import SAMPLES
from tunefree_hil.plant.types import BodyOutput
from tunefree_hil.plant.vehicle import assemble

SIZE = 0.25  # of the weights: a rectifier has no bound


def weave(t: float) -> Command:
    return command(0.35 if t < 0.6 else REST, REST if t < 0.8 else 0.25, 2.0 * math.sin(3.0 * t))


def driven(folder: Path, spacing_s: float, seconds: float = 1.2) -> list[BodyOutput]:
    body = assemble(plant_of(folder, "paper", size=SIZE), {"sample_spacing_s": spacing_s}, CHANNELS)
    return drive(body, weave, seconds, start=Start(speed_mps=8.0))


def rows_of(outputs: list[BodyOutput]) -> np.ndarray:
    """Samples by tick, as Table I has them; the tick that ends with outputs[k + 1] sees row k."""
    found = []
    for k, out in enumerate(outputs):
        told = weave(k * DT_S)
        pedals = (told.throttle_frac - REST, told.brake_frac - REST, told.steer_rad)
        found.append((*pedals, out.motion.speed_mps, out.motion.speed_rate_mps2))
    return np.array(found)


@pytest.mark.parametrize("spacing_s", [0.01, 0.05])
def test_every_tick_sees_its_own_window(spacing_s: float, tmp_path: Path) -> None:
    a, gap = arrays_of("paper", size=SIZE), round(spacing_s / DT_S)
    outputs = driven(tmp_path, spacing_s)
    rows = rows_of(outputs)
    rolled = np.array([0.0, 0.0, 0.0, 8.0, 0.0])
    own, yaw = 0.0, 0.0
    for k in range(len(outputs) - 1):
        places = [k - gap * (SAMPLES - 1 - j) for j in range(SAMPLES)]
        window = np.array([rows[at] if at >= 0 else rolled for at in places])
        said = np.clip(by_numpy(a, window, True)[-1], -a["bound"], a["bound"])
        own, yaw = own + (said[0] - own) / gap, yaw + (said[1] - yaw) / gap
        now = outputs[k + 1].motion
        assert now.speed_rate_mps2 == pytest.approx(own, abs=1e-5)
        assert now.yaw_rate_radps == pytest.approx(yaw, abs=1e-5)
        own, yaw = now.speed_rate_mps2, now.yaw_rate_radps
    assert np.ptp(rows[:, 4]) > 0.05, "the case moves"


def test_commands_go_in_and_are_reported(tmp_path: Path) -> None:
    outputs = driven(tmp_path, 0.01, 0.5)
    for k, out in enumerate(outputs[1:]):
        told = weave(k * DT_S)
        assert out.actuation[:3] == (told.throttle_frac, told.brake_frac, told.steer_rad), "no actuator in between"


@pytest.mark.parametrize("spacing_s", [0.0, -0.01, 2.0, math.nan])
def test_a_spacing_that_is_none(spacing_s: float, tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        driven(tmp_path, spacing_s)
    assert caught.value.key == "plant.params.sample_spacing_s"
