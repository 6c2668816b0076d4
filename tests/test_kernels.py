"""Kernels say the same bits in plain Python and compiled: what docs/explanation/architecture.md bans is not in them.

Checked are functions decorated with @kernel and the functions of the same module that they call.
"""

from __future__ import annotations

import pytest

from tests.house import kernel_maths, package_files, place
from tests.kernel_rules import complaints_of

MATHS = kernel_maths()


def complaints(source: str, inside: str = "plant/some.py") -> list[str]:
    return complaints_of(source, inside, MATHS)


def test_the_list_of_functions_is_read() -> None:
    assert {"sin", "sqrt", "floor"} <= MATHS
    assert not {"hypot", "fmod", "pow"} & MATHS


def test_kernels_use_what_they_may() -> None:
    found = [line for path in package_files() for line in complaints(path.read_text(), place(path))]
    assert not found, "\n".join(found)


def kernel(body: str, head: str = "") -> str:
    lines = "\n".join("    " + line for line in body.splitlines())
    return f"import math\nimport numpy as np\n{head}\n@kernel\ndef step(params, state, x, dt_s):\n{lines}\n"


@pytest.mark.parametrize(
    ("body", "word"),
    [
        ("return x**2", "**"),
        ("x **= 2\nreturn x", "**"),
        ("return x % 1.5", "%"),
        ("return x % state.count", "%"),
        ("return math.hypot(x, x)", "hypot"),
        ("return math.fmod(x, 2.0)", "fmod"),
        ("return math.pow(x, 2.0)", "pow"),
        ("return pow(x, 2.0)", "pow"),
        ("return np.sin(x)", "numpy"),
        ("return f'{x}'", "f-string"),
        ("return {'a': x}", "dict"),
        ("return {x}", "set"),
        ("return [y for y in x]", "comprehension"),
        ("return sum(y for y in x)", "comprehension"),
        ("try:\n    return x\nfinally:\n    pass", "try"),
        ("return 'word'", "string"),
        ("if x is None:\n    return 1.0\nreturn 2.0", "None"),
        ("return x._replace(a=1.0)", "_replace"),
        ("raise ValueError", "raise"),
        ("return lambda: x", "lambda"),
        ("return x / params.tau_s", "division"),
        ("return x / state.speed_mps", "division"),
        ("y = x - 1.0\nreturn 1.0 / y", "division"),
        ("x /= params.tau_s\nreturn x", "division"),
        ("return x / 0.0", "division"),
        ("if x > 0.0:\n    return 1.0\nreturn x / params.tau_s", "division"),
        ("return isinstance(x, float)", "isinstance"),
        ("import math as m\nreturn x", "import"),
    ],
)
def test_a_planted_violation_is_found(body: str, word: str) -> None:
    found = complaints(kernel(body))
    assert any(word in line for line in found), found


@pytest.mark.parametrize(
    "body",
    [
        '"""One line."""\nreturn math.sin(x) * dt_s',
        "return x / dt_s",
        "return x / 2.0",
        "return x / LENGTH_M",
        "return (x - 1.0) / (params.tau_s + dt_s)",
        "return x / max(state.speed_mps, 0.1)",
        "if params.tau_s <= 0.0:\n    return x\nreturn x / params.tau_s",
        "if params.tau_s > 0.0:\n    x = x / params.tau_s\nreturn x",
        "return x / params.tau_s if params.tau_s > 0.0 else 0.0",
        "width = params.a - params.b\nif width <= 0.0:\n    return 0.0\nreturn x / width",
        "speed = max(state.speed_mps, 0.1)\nreturn x / (speed * speed)",
        "return x / params.mass_kg  # not 0: config/load.py refuses it",
        "head = (int(state.head) + 1) % len(state.ring)\nreturn state.ring[head]",
        "for i in range(10):\n    x = x + i % 3\nreturn x",
        "return abs(x) + min(x, 1.0) + float(params.a[0]) + math.pi",
        "return math.floor(x / 0.5 + 0.5) * 0.5",
    ],
)
def test_what_is_allowed_is_fine(body: str) -> None:
    assert complaints(kernel(body)) == []


def test_a_callee_in_the_same_module_is_checked() -> None:
    source = "def helper(x):\n    return x**2\n" + kernel("return helper(x)")
    assert any("helper" in line for line in complaints(source))
    assert complaints("def helper(x):\n    return x**2\n" + kernel("return x")) == []


def test_a_nested_kernel_is_checked() -> None:
    source = "def make():\n    @kernel\n    def step(p, s, x, dt_s):\n        return s, x**3\n    return step\n"
    assert complaints(source)


def test_a_function_that_is_no_kernel_is_free() -> None:
    assert complaints("import numpy as np\ndef build(x):\n    return {k: np.hypot(1, k) for k in x}\n") == []


def test_functions_imported_from_math_are_seen() -> None:
    source = "from math import hypot\n@kernel\ndef step(p, s, x, dt_s):\n    return s, hypot(x, x)\n"
    assert any("hypot" in line for line in complaints(source))
