"""Box edges, binary32 and distributions (docs/reference/controller.md)."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.base.contracts import Tunable
from tunefree_hil.base.errors import InputError
from tunefree_hil.config.schema import ParameterSpec
from tunefree_hil.control.parameters import BY_NAME, NAMES, WIDER_BOXES, BoxChoice
from tunefree_hil.tune.space import make_space, resolve_space, space_from_data


def binary32(value: float) -> float:
    return struct.unpack("<f", struct.pack("<f", value))[0]


def spec(**given: object) -> ParameterSpec:
    return ParameterSpec(**{"name": "p", "low": 0.1, "high": 0.7, "scale": "linear", **given})  # type: ignore[arg-type]


@given(low=st.floats(-1e30, 1e30), width=st.floats(1e-3, 1e3), value=st.floats(allow_nan=False))
def test_edges_go_inward_and_values_stay_inside(low: float, width: float, value: float) -> None:
    high = low + width * max(abs(low), 1e-3)
    axis = make_space([spec(low=low, high=high)]).axes[0]
    assert low <= axis.low < axis.high <= high
    fitted = axis.clip(value)
    assert axis.low <= fitted <= axis.high
    assert all(binary32(number) == number for number in (axis.low, axis.high, fitted))


@given(low=st.floats(1e-6, 1.0), width=st.floats(1e-3, 100.0))
def test_edges_are_the_nearest_inside(low: float, width: float) -> None:
    axis = make_space([spec(low=low, high=low + width)]).axes[0]
    assert axis.low - low < 1.2e-7 * low and low + width - axis.high < 1.2e-7 * (low + width)


@given(value=st.floats(0.1, 0.7))
def test_a_fitted_value_is_the_nearest_binary32(value: float) -> None:
    axis = make_space([spec()]).axes[0]
    assert axis.clip(value) in (binary32(value), axis.low, axis.high)
    assert axis.clip(axis.clip(value)) == axis.clip(value)


@given(place=st.integers(0, 6), off=st.floats(-0.04, 0.04))
def test_steps_are_the_multiples_from_low(place: int, off: float) -> None:
    axis = make_space([spec(step=0.1)]).axes[0]
    assert axis.grid == tuple(min(max(binary32(0.1 + 0.1 * k), axis.low), axis.high) for k in range(7))
    assert axis.clip(0.1 + 0.1 * place + off) == axis.grid[place]
    assert axis.from_sampler(axis.to_sampler(axis.grid[place])) == axis.grid[place]
    assert axis.to_sampler(axis.grid[place]) == place


def test_choices_have_no_order_for_the_sampler() -> None:
    axis = make_space([spec(choices=[4.0, 0.1, 1.0])]).axes[0]
    assert axis.sampler_distribution() == axis.stored_distribution()
    assert axis.grid == (binary32(0.1), 1.0, 4.0)
    assert axis.clip(3.0) == 4.0


@pytest.mark.parametrize("extra", [{}, {"step": 0.1}, {"choices": [1.0, 2.0]}, {"low": 0.2, "scale": "log"}])
def test_a_described_space_is_the_same_space(extra: dict[str, object]) -> None:
    space = make_space([spec(**extra), spec(name="q")])
    assert space_from_data(space.as_data()) == space


@pytest.mark.parametrize(
    ("extra", "word"),
    [
        ({"low": 0.0, "scale": "log"}, "log scale"),
        ({"low": -1.0, "scale": "log"}, "log scale"),
        ({"low": 0.7}, "empty range"),
        ({"low": 0.7, "high": 0.1}, "empty range"),
        ({"low": 0.1 + 1e-12, "high": 0.1 + 2e-12}, "empty range"),
        ({"high": float("inf")}, "range"),
        ({"high": float("nan")}, "range"),
        ({"high": 1e39}, "range"),
        ({"step": 0.1, "scale": "log"}, "steps on a log scale"),
        ({"step": 0.0}, "step"),
        ({"step": 1.0}, "step"),
        ({"step": 1e-9}, "step"),
        ({"choices": [1.0]}, "choices"),
        ({"choices": [1.0, 2.0], "step": 0.1}, "choices"),
        ({"name": "same"}, "twice"),
    ],
)
def test_what_does_not_fit_is_refused_by_name(extra: dict[str, object], word: str) -> None:
    with pytest.raises(InputError, match=word) as caught:
        make_space([spec(name="same"), spec(**extra)], file="bench.toml")
    assert caught.value.file == "bench.toml"
    assert caught.value.hint
    assert caught.value.key == f"tune.parameters {extra.get('name', 'p')}"


@pytest.mark.parametrize(("name", "count"), [("mrac", 2), ("lateral", 6), ("complete", 11)])
def test_sets_are_those_of_the_interfaces(name: str, count: int) -> None:
    space = resolve_space(name, [])
    assert space.names == NAMES[:count]
    assert all(axis.log for axis in space.axes)
    assert not any(axis.log for axis in resolve_space(name, [], scale="linear").axes)
    for axis in space.axes:
        box = BY_NAME[axis.name].tunable
        assert box.low <= axis.low <= box.low * (1 + 2e-7) and box.high * (1 - 2e-7) <= axis.high <= box.high


def test_a_listed_parameter_takes_the_box_of_the_table() -> None:
    mine = Tunable("mine.gain", "1", 2.0, 3.0)
    specs = [
        ParameterSpec(name="lqr.q2"),
        ParameterSpec(name="lqr.q1", low=0.1, high=0.2),
        ParameterSpec(name="mrac.enable"),
        ParameterSpec(name="mine.gain"),
        ParameterSpec(name="look_ahead_m", scale="linear", step=0.5),
    ]
    space = resolve_space("", specs, announced=[mine])
    assert space.axes[0] == resolve_space("lateral", []).axes[3]
    assert (space.axes[1].low, space.axes[1].high) == pytest.approx((0.1, 0.2))
    assert space.axes[2].grid == (0.0, 1.0) and space.axes[2].choices
    assert (space.axes[3].low, space.axes[3].high) == (2.0, 3.0)
    assert space.axes[4].grid == tuple(0.5 * k for k in range(11))
    assert space.axes[0].log
    assert not resolve_space("", [ParameterSpec(name="lqr.q2", scale="linear")]).axes[0].log


def test_parameters_are_listed_beside_a_set() -> None:
    space = resolve_space("mrac", [ParameterSpec(name="speed.preview_s", low=0.1, high=0.4, scale="linear")])
    assert space.names == (*NAMES[:2], "speed.preview_s")
    assert not space.axes[2].log and (space.axes[2].low, space.axes[2].high) == pytest.approx((0.1, 0.4))


@pytest.mark.parametrize(
    ("set_name", "specs"),
    [
        ("mrac", [ParameterSpec(name="mrac.p")]),
        ("lateral6", []),
        ("", []),
        ("", [ParameterSpec(name="lqr.q5")]),
        ("", [ParameterSpec(name="lqr.q1", step=0.1)]),
    ],
)
def test_a_tune_table_that_asks_for_nothing_sound(set_name: str, specs: list[ParameterSpec]) -> None:
    with pytest.raises(InputError):
        resolve_space(set_name, specs)


def test_fit_takes_each_parameter_on_its_own() -> None:
    space = resolve_space("mrac", [])
    fitted = space.clip({"mrac.t_ref_s": -5.0, "mrac.p": 0.0625, "other": 1.0})
    assert fitted == {"mrac.t_ref_s": space.axes[0].low, "mrac.p": 0.0625}
    with pytest.raises(InputError, match=r"mrac\.p"):
        space.clip({"mrac.t_ref_s": 0.1})
    with pytest.raises(InputError, match="not a number"):
        space.clip({"mrac.t_ref_s": float("nan"), "mrac.p": 0.05})


def test_the_wider_box_holds_the_published_one_but_its_highest_speed_gains() -> None:
    paper, wider = resolve_space("complete", []), resolve_space("complete", [], box=BoxChoice.DEFAULT)
    assert resolve_space("complete", [], box=BoxChoice.PAPER) == paper
    pairs = list(zip(paper.axes, wider.axes, strict=True))
    assert all(wide.low <= narrow.low < narrow.high for narrow, wide in pairs)
    assert {narrow.name for narrow, wide in pairs if wide.high < narrow.high} == {"speed.kp_low", "speed.kp_high"}
    assert {narrow.name for narrow, wide in pairs if wide != narrow} == set(WIDER_BOXES)


def test_a_range_of_the_bench_file_is_that_range_in_either_box() -> None:
    given = ParameterSpec(name="lqr.q1", low=0.2, high=0.3)
    assert resolve_space("", [given], box=BoxChoice.DEFAULT) == resolve_space("", [given])
    without = ParameterSpec(name="lqr.q1")
    assert resolve_space("", [without], box=BoxChoice.DEFAULT).axes[0].low < resolve_space("", [without]).axes[0].low
