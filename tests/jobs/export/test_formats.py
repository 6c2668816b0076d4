"""Numbers, text protos and YAML as text, read back."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.jobs.export.read_back import read_text_proto, read_yaml
from tunefree_hil.control.parameters import round32
from tunefree_hil.jobs.export.number_text import format_number
from tunefree_hil.jobs.export.text_proto import Message, render
from tunefree_hil.jobs.export.yaml_text import format_scalar, render_parameters


@given(st.floats(width=32, allow_nan=False, allow_infinity=False))
def test_a_binary32_number_comes_back(value: float) -> None:
    assert round32(float(format_number(value))) == value
    assert round32(float(format_scalar(value))) == value


@pytest.mark.parametrize(
    ("value", "text"),
    [(round32(0.05), "0.05"), (155494.663, "155494.663"), (1.0, "1"), (1e300, "1e+300"), (-0.3, "-0.3")],
)
def test_texts_are_short(value: float, text: str) -> None:
    assert format_number(value) == text


def test_a_message_comes_back() -> None:
    inner = Message(speed=4.0, is_on=True)
    text = render(Message(order=2, q=[0.1, 0.2], part=[inner, inner], empty=Message()))
    assert read_text_proto("# a comment\n" + text) == {
        "order": [2.0],
        "q": [0.1, 0.2],
        "part": [{"speed": [4.0], "is_on": [True]}] * 2,
        "empty": [{}],
    }


def test_parameters_come_back() -> None:
    parameters = {"kp": 1.0, "path": "a.csv", "steer_pid": {"max": -8.0, "on": False}, "last": 1e-9}
    assert read_yaml(render_parameters(parameters, ("a comment",))) == parameters
