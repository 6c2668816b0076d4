"""A drive opened: what each link begins from, and what a log that lacks something cannot show."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

import numpy as np
import pytest

from tests.learn.made_drives import made_drive
from tunefree_hil.base.contracts import Link
from tunefree_hil.base.errors import InputError
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.gap.chain import Opened, open_chain
from tunefree_hil.gap.excitation import excitation, held_by
from tunefree_hil.gap.graph import effects
from tunefree_hil.gap.targets import Compared
from tunefree_hil.learn.drives import Drive

pytestmark = pytest.mark.slow


@cache
def drive() -> Drive:
    return made_drive(60.0)


def opened(without: Iterable[str] = ()) -> Opened:
    gone = tuple(without)
    fields = {key: one for key, one in drive().fields.items() if not key.startswith(gone)} if gone else drive().fields
    return open_chain(drive()._replace(fields=fields), load_vehicle("mkz_bywire"))


def names(one: Opened) -> set[str]:
    return {target.name for target in Compared(one).targets}


def test_a_whole_log_shows_every_link() -> None:
    one = opened()
    assert not one.lost and one.inputs.measured == (True, True, True) and one.inputs.by_ins
    assert {"throttle", "brake", "steer", "rate_of_speed", "yaw_rate", "wheel_vs_ins", "yaw_vs_ins"} <= names(one)


def test_without_an_ins_its_links_are_lost_by_name() -> None:
    one = opened(["ins."])
    assert {Link.WHEEL_VS_INS, Link.YAW_VS_INS} <= set(one.lost)
    assert not {"wheel_vs_ins", "yaw_vs_ins"} & names(one) and {"rate_of_speed", "yaw_rate"} <= names(one)


def test_without_reports_the_chain_goes_from_commands() -> None:
    one = opened(["report.throttle_frac", "report.brake_frac", "report.steer_rad"])
    assert Link.COMMAND_TO_REPORT in one.lost and one.inputs.measured == (False, False, False)
    assert not {"throttle", "brake", "steer"} & names(one)


def test_without_any_speed_nothing_can_be_told() -> None:
    with pytest.raises(InputError, match="speed"):
        opened(["ins.speed", "report.speed"])


def test_the_drive_holds_what_effects_need_and_says_what_it_lacks() -> None:
    held = held_by([opened()], load_vehicle("mkz_bywire"))
    assert held["moving_s"] > 20.0 and held["brakings"] >= 2.0 and held["steer_reversals"] > 5.0
    still = excitation(effects(), dict.fromkeys(held, 0.0))
    needy = [name for name, effect in effects().items() if effect.needs]
    assert all(not still[name].enough and still[name].lacks and still[name].score == 0.0 for name in needy)
    assert all(one.enough for one in excitation(effects(), dict.fromkeys(held, 1e6)).values())


def test_what_was_measured_is_there_where_the_log_has_it() -> None:
    one = opened()
    assert np.isfinite(one.inputs.commands).all() and np.isfinite(one.inputs.outputs).all()
    assert one.follows[200:].mean() > 0.95
