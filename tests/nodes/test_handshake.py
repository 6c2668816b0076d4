"""The take-over: every way in, every way out, and never back by itself."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.nodes.handshake import ENDED, Handshake, Limits, Stage, VehicleState, limits_of

READY = VehicleState(known=True)
ON = VehicleState(known=True, enabled=True)
LIMITS = limits_of(0.01)
states = st.builds(VehicleState, st.booleans(), st.booleans(), st.booleans(), st.booleans())


def test_engages_when_every_channel_answers():
    hand = Handshake(LIMITS)
    assert hand.advance(0, VehicleState()) is Stage.ENABLING and hand.enable
    assert hand.advance(1, READY) is Stage.ENABLING
    assert hand.advance(2, ON) is Stage.ENGAGED and hand.enable


def test_enabled_bits_not_yet_heard_are_no_engagement():
    hand = Handshake(LIMITS)
    assert hand.advance(0, VehicleState(known=False, enabled=True)) is Stage.ENABLING


def test_gives_up_after_the_limit():
    hand = Handshake(LIMITS)
    stages = [hand.advance(k, READY) for k in range(41)]
    assert stages[39] is Stage.ENABLING
    assert stages[40] is Stage.NOT_ENABLED and not hand.enable


@pytest.mark.parametrize(
    ("tick_s", "limits"),
    [(0.001, (400, 50, 60)), (0.005, (80, 10, 12)), (0.01, (40, 5, 6)), (0.02, (20, 2, 3)), (1.0, (1, 1, 1))],
)
def test_the_limits_are_times_whatever_the_tick(tick_s, limits):
    """0.4 s to answer in, a clear frame every 50 ms, 60 ms for the report that says why."""
    assert limits_of(tick_s) == Limits(*limits)


def test_a_latched_override_is_cleared_at_20_hz_before_enabling():
    hand = Handshake(LIMITS)
    latched = VehicleState(known=True, override=True)
    clears = []
    for k in range(12):
        assert hand.advance(k, latched) is Stage.CLEARING
        assert not hand.enable
        clears.append(hand.clear_now)
    assert [k for k, clear in enumerate(clears) if clear] == [0, 5, 10]
    assert hand.advance(12, READY) is Stage.ENABLING and hand.enable and not hand.clear_now
    assert hand.advance(13, ON) is Stage.ENGAGED


def test_an_override_that_stays_latched_ends_it():
    hand = Handshake(LIMITS._replace(answer_ticks=10))
    stages = [hand.advance(k, VehicleState(known=True, override=True)) for k in range(12)]
    assert stages[-1] is Stage.NOT_ENABLED


@pytest.mark.parametrize(
    ("state", "stage"),
    [
        (ON._replace(override=True), Stage.OVERRIDE),
        (ON._replace(fault=True), Stage.FAULT),
        (ON._replace(override=True, fault=True), Stage.FAULT),
    ],
)
def test_engaged_is_lost_at_once(state, stage):
    hand = Handshake(LIMITS)
    hand.advance(0, ON)
    assert hand.advance(1, state) is stage
    assert not hand.enable


def test_a_channel_that_left_is_given_time_to_say_why():
    """The bit that says so is in a report of its own, up to 50 ms later; the drive ends by the right name."""
    for why, stage in ((READY, Stage.DROPPED), (READY._replace(override=True), Stage.OVERRIDE)):
        hand = Handshake(LIMITS)
        hand.advance(0, ON)
        hand.advance(1, ON)
        assert all(hand.advance(1 + k, READY) is Stage.ENGAGED for k in range(1, LIMITS.why_ticks))
        assert hand.advance(1 + LIMITS.why_ticks, why) is stage and not hand.enable
    hand = Handshake(LIMITS)
    assert [hand.advance(k, ON if k % 4 == 0 else READY) for k in range(40)] == [Stage.ENGAGED] * 40, "it came back"


@given(st.lists(states, min_size=1, max_size=60))
def test_an_ended_engagement_never_comes_back(sequence):
    hand = Handshake(LIMITS._replace(answer_ticks=8))
    ended = None
    for k, state in enumerate(sequence):
        stage = hand.advance(k, state)
        if ended is not None:
            assert stage is ended and not hand.enable and not hand.clear_now
        elif stage in ENDED:
            ended = stage
