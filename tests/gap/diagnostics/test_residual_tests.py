"""Links that are broken: by what could be explained, or by moments that nothing foretells."""

from __future__ import annotations

import pytest

from tunefree_hil.base.contracts import Link
from tunefree_hil.gap.diagnostics.lack_of_fit import LackOfFit
from tunefree_hil.gap.diagnostics.residual_tests import LINK_CRITERIA, Burst, assess_links
from tunefree_hil.gap.estimation.residuals import TargetProperties

NAMES = ("shaken", "pothole", "even", "slanted")
KINDS = {name: TargetProperties(name, Link.REPORT_TO_MOTION, "m/s2", 0.05, 0.0) for name in NAMES}
LEFT = {name: LackOfFit(0.01, 0.0) for name in NAMES[:3]} | {"slanted": LackOfFit(0.02, 0.01)}


def test_a_link_is_broken_by_loud_moments_in_several_blocks() -> None:
    bursts = {"shaken": Burst(0.4, 0.05, 3), "pothole": Burst(0.4, 0.05, 1), "even": Burst(0.4, 0.2, 9)}
    found = assess_links(LEFT, KINDS, dict.fromkeys(NAMES, 1.0), bursts)
    assert [one.signal for one in found[:2]] == ["shaken", "slanted"]
    assert {one.signal for one in found if one.is_broken} == {"shaken", "slanted"}
    assert found[0].text == "shaken is missed by 38% of the signal in short bursts, and hardly elsewhere"
    assert found[1].text == "slanted is missed by 10.0%"


def test_of_an_actuators_report_one_loud_moment_is_enough() -> None:
    """No pothole is in it: a rate limit that one manoeuvre reaches."""
    kinds = {"steer": TargetProperties("steer", Link.COMMAND_TO_REPORT, "rad", 0.05, 0.0)}
    (found,) = assess_links({"steer": LackOfFit(0.01, 0.0)}, kinds, {"steer": 1.0}, {"steer": Burst(0.4, 0.05, 1)})
    assert found.is_broken and found.burst_share > LINK_CRITERIA.max_burst_share


def test_loud_moments_are_held_against_the_signal() -> None:
    found = assess_links(LEFT, KINDS, dict.fromkeys(NAMES, 5.0), {"shaken": Burst(0.4, 0.05, 3)})
    assert not any(one.is_broken for one in found)


def test_a_link_is_not_broken_by_what_its_own_calibration_missed_of_other_drives_within_bounds() -> None:
    """slanted is missed by a tenth."""

    def broken(missed: float, explicable: float) -> bool:
        kinds = {"slanted": KINDS["slanted"]._replace(calibration_misfit=missed)}
        (one,) = assess_links({"slanted": LackOfFit(0.01, explicable**2)}, kinds, {"slanted": 1.0})
        return one.is_broken

    assert broken(0.0, 0.04) and not broken(0.05, 0.04) and broken(0.05, 0.055)
    assert broken(0.5, 0.07), "a model that misses half of its own drives lacks something itself"


def test_what_is_grossly_missed_is_broken_whether_anything_foretells_it_or_not() -> None:
    """A steering that lies half of its way off now and then, in most of a drive: no moment stands out."""
    kinds = {"steer": TargetProperties("steer", Link.COMMAND_TO_REPORT, "rad", 0.01, 0.0, noise=0.002)}
    (one,) = assess_links({"steer": LackOfFit(0.25, 0.0)}, kinds, {"steer": 1.0})
    assert one.is_broken and one.gross_share == pytest.approx(0.5, rel=1e-3) == one.misfit_share
    assert one.text == "steer is missed by 50% of the signal, and no regression explains most of that"
    loudly = {"steer": kinds["steer"]._replace(noise=0.2)}  # the sensor's own
    assert not assess_links({"steer": LackOfFit(0.25, 0.0)}, loudly, {"steer": 1.0})[0].is_broken
    assert not assess_links({"steer": LackOfFit(0.04, 0.0)}, kinds, {"steer": 1.0})[0].is_broken
    bumps = {"steer": kinds["steer"]._replace(is_yaw_from_wheels=True)}
    bursts = {"steer": Burst(0.5, 0.01, 3, 1.0)}
    assert assess_links({"steer": LackOfFit(0.01, 0.0)}, kinds, {"steer": 1.0}, bursts)[0].is_broken
    assert not assess_links({"steer": LackOfFit(0.25, 0.0)}, bumps, {"steer": 1.0}, bursts)[0].is_broken
    assert assess_links({"steer": LackOfFit(0.25, 0.25)}, bumps, {"steer": 1.0})[0].is_broken, (
        "what is foretold no bump did"
    )
    (told,) = assess_links({"steer": LackOfFit(0.25, 0.25)}, kinds, {"steer": 1.0})
    assert told.is_broken and told.text == "steer is missed by 50.0%"
