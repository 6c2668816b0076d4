"""Links that are broken: by what could be explained, or by moments that nothing foretells."""

from __future__ import annotations

import pytest

from tunefree_hil.base.contracts import Link
from tunefree_hil.gap.diagnostics.lack_of_fit import Left
from tunefree_hil.gap.diagnostics.residual_tests import LOUD, Burst, look
from tunefree_hil.gap.estimation.residuals import Kind

NAMES = ("shaken", "pothole", "even", "slanted")
KINDS = {name: Kind(name, Link.REPORT_TO_MOTION, "m/s2", 0.05, 0.0) for name in NAMES}
LEFT = {name: Left(0.01, 0.0) for name in NAMES[:3]} | {"slanted": Left(0.02, 0.01)}


def test_a_link_is_broken_by_loud_moments_in_several_blocks() -> None:
    bursts = {"shaken": Burst(0.4, 0.05, 3), "pothole": Burst(0.4, 0.05, 1), "even": Burst(0.4, 0.2, 9)}
    found = look(LEFT, KINDS, dict.fromkeys(NAMES, 1.0), bursts)
    assert [one.signal for one in found[:2]] == ["shaken", "slanted"]
    assert {one.signal for one in found if one.broken} == {"shaken", "slanted"}
    assert found[0].missed == "shaken is missed by 38% of the signal in moments, and hardly else"
    assert found[1].missed == "slanted is missed by 10.0%"


def test_of_an_actuators_report_one_loud_moment_is_enough() -> None:
    """No pothole is in it: a rate limit that one manoeuvre reaches."""
    kinds = {"steer": Kind("steer", Link.COMMAND_TO_REPORT, "rad", 0.05, 0.0)}
    (found,) = look({"steer": Left(0.01, 0.0)}, kinds, {"steer": 1.0}, {"steer": Burst(0.4, 0.05, 1)})
    assert found.broken and found.loud > LOUD


def test_loud_moments_are_held_against_the_signal() -> None:
    found = look(LEFT, KINDS, dict.fromkeys(NAMES, 5.0), {"shaken": Burst(0.4, 0.05, 3)})
    assert not any(one.broken for one in found)


def test_a_link_is_not_broken_by_what_its_own_calibration_missed_of_other_drives_within_bounds() -> None:
    """slanted is missed by a tenth."""

    def broken(missed: float, explicable: float) -> bool:
        kinds = {"slanted": KINDS["slanted"]._replace(missed=missed)}
        (one,) = look({"slanted": Left(0.01, explicable**2)}, kinds, {"slanted": 1.0})
        return one.broken

    assert broken(0.0, 0.04) and not broken(0.05, 0.04) and broken(0.05, 0.055)
    assert broken(0.5, 0.07), "a model that misses half of its own drives lacks something itself"


def test_what_is_grossly_missed_is_broken_whether_anything_foretells_it_or_not() -> None:
    """A steering that lies half of its way off now and then, in most of a drive: no moment stands out."""
    kinds = {"steer": Kind("steer", Link.COMMAND_TO_REPORT, "rad", 0.01, 0.0, noise=0.002)}
    (one,) = look({"steer": Left(0.25, 0.0)}, kinds, {"steer": 1.0})
    assert one.broken and one.gross == pytest.approx(0.5, rel=1e-3) == one.amount
    assert one.missed == "steer is missed by 50% of the signal, and little of that is foretold by anything"
    loudly = {"steer": kinds["steer"]._replace(noise=0.2)}  # the sensor's own
    assert not look({"steer": Left(0.25, 0.0)}, loudly, {"steer": 1.0})[0].broken
    assert not look({"steer": Left(0.04, 0.0)}, kinds, {"steer": 1.0})[0].broken
    bumps = {"steer": kinds["steer"]._replace(by_wheels=True)}
    bursts = {"steer": Burst(0.5, 0.01, 3, 1.0)}
    assert look({"steer": Left(0.01, 0.0)}, kinds, {"steer": 1.0}, bursts)[0].broken
    assert not look({"steer": Left(0.25, 0.0)}, bumps, {"steer": 1.0}, bursts)[0].broken
    assert look({"steer": Left(0.25, 0.25)}, bumps, {"steer": 1.0})[0].broken, "what is foretold no bump did"
    (told,) = look({"steer": Left(0.25, 0.25)}, kinds, {"steer": 1.0})
    assert told.broken and told.missed == "steer is missed by 50.0%"
