"""Rolling counters: what follows what."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.bus.integrity import Counted, CounterCheck, Order, check_counter, next_counter


@given(st.integers(2, 256), st.integers(0, 600))
def test_a_counter_in_order_is_always_ok(modulus: int, frames: int) -> None:
    check, counter = CounterCheck(modulus), 0
    for i in range(frames):
        order = check.hear(float(counter)).order
        assert order is (Order.FIRST if i == 0 else Order.OK)
        counter = next_counter(counter, modulus)
    assert counter == frames % modulus


@given(st.integers(3, 256), st.data())
def test_what_is_missing_is_counted(modulus: int, data: st.DataObject) -> None:
    last, lost = data.draw(st.integers(0, modulus - 1)), data.draw(st.integers(1, modulus - 2))
    heard = (last + lost + 1) % modulus
    assert check_counter(last, heard, modulus, max_delta=1) == Counted(Order.WRONG, lost)
    assert check_counter(last, heard, modulus, max_delta=lost + 1) == Counted(Order.SOME_LOST, lost)


def test_a_stuck_counter_is_noticed_and_counted_in_a_row() -> None:
    check = CounterCheck(256)
    orders = [check.hear(value).order for value in (9, 9, 9, 10, 10)]
    assert orders == [Order.FIRST, Order.REPEATED, Order.REPEATED, Order.OK, Order.REPEATED]
    assert check.repeats == 1


def test_a_restarted_sender_is_followed_again() -> None:
    check = CounterCheck(256)
    orders = [check.hear(value).order for value in (200, 0, 1)]
    assert orders == [Order.FIRST, Order.WRONG, Order.OK]


def test_it_rolls_over_at_the_modulus() -> None:
    assert next_counter(255, 256) == 0 and next_counter(14, 15) == 0
    assert check_counter(255, 0, 256).order is Order.OK
