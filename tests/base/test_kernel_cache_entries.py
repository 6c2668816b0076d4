"""Which edits of a kernel's source give another cache entry, and which do not."""

from __future__ import annotations

import math
import string
import struct
import threading
from collections import namedtuple
from collections.abc import Callable
from itertools import count
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.base.test_kernel_cache import Context, Result
from tunefree_hil.base.kernel_cache import KernelCache

HELPERS = string.Template("""
LOW, HIGH = 1.0, 2.0

def far(x):
    return x * $far_factor
""")

DEEP = string.Template("""
def near(x):
    return x * $near_factor
""")

SOURCE = string.Template("""
import enum
from typing import NamedTuple
import numpy as np
from tunefree_hil.base.kernel import kernel

class Axle(NamedTuple):
    $record_fields

class Stage(enum.IntEnum):
    OFF = $member_value
    ON = 7

FACTOR = $constant
ROW = $array
LIMITS = (1.0, (2, $nested_constant), $row_in_tuple)
AXLE = Axle($record_values)

@kernel
def last(x):
    return x $operator 3.0

@kernel
def middle(x):
    return last(x) + $middle_offset

@kernel
def in_tuple(x):
    return x + $in_tuple_offset

CHOICES = (in_tuple,)

@kernel
def again(x, n):
    return $recursion_start if n == 0 else again(x, n - 1)

def make(gain, table, callee):
    @kernel
    def step(p, $arguments, scale=$default, *, bias=$keyword_default):
        def inner(y):
            return y + $inner_constant + FACTOR + $inner_global
        $local = p.$attribute * gain + table[0] + callee(a)
        total = $local + $literal + (a $comparison b) + (a in $member_set)
        total += middle(a) + inner(b) + ROW[0] + LIMITS[0] + AXLE.$axle_attribute + again(a, 2) + CHOICES[0](a)
        total += helpers.far(b) + helpers.deep.near(b) + helpers.$module_attribute
        return Axle(total, Stage.$member) if a > scale + bias else Axle(0.0, Stage.OFF)
    return step

@kernel
def closed(x):
    return x + $closed_offset

step = make($gain, $table, closed)

LATE = $late_constant
""")

SLOTS: dict[str, tuple[str, ...]] = {
    "attribute": ("ref_curvature_1pm", "preview_curvature_1pm", "x"),
    "axle_attribute": ("front_m", "rear_m"),
    "module_attribute": ("LOW", "HIGH"),
    "member": ("ON", "OFF"),
    "member_value": ("0", "1"),
    "record_fields": (
        "front_m: float; rear_m: float = 1.5",
        "rear_m: float; front_m: float = 1.5",
        "front_m: float; back_m: float = 1.5; rear_m: float = 1.0",
        "front_m: float; rear_m: float = 2.5",
        "front_m: float; rear_m: int = 1.5",
    ),
    "record_values": ("1.0, 2.0", "2.0, 1.0", "1, 2.0", "True, 2.0"),
    "constant": (
        *("0.0", "-0.0", "0", "False", "1.0", "1", "True", "1j", "(1.0,)", "float('nan')", "None", "int", "float"),
        *("np.float64(1.0)", "np.float32(1.0)", "np.int64(1)"),
    ),
    "nested_constant": ("0.0", "-0.0", "0", "False", "None"),
    "array": (
        *("np.array([1.0, 2.0])", "np.array([1.0, 3.0])", "np.array([[1.0, 2.0]])", "np.array([[1.0], [2.0]])"),
        *("np.array([1.0, 2.0], dtype='>f8')", "np.array([1.0, 2.0]).view(np.int64)", "(1.0, 2.0)", "[1.0, 2.0]"),
        *("np.ones((2, 2))", "np.asfortranarray(np.ones((2, 2)))", "np.array([1.0, 2.0], dtype=object)"),
        "np.array([(1.0, 2.0)], dtype=[('a', 'f8'), ('b', 'f8')])",
        "np.array([(1.0, 2.0)], dtype=[('b', 'f8'), ('a', 'f8')])",
    ),
    "row_in_tuple": ("np.zeros(2000)", "np.eye(1, 2000, 1000)[0]"),
    "operator": ("+", "-", "*", "/"),
    "comparison": ("<", "<="),
    "middle_offset": ("1.0", "1", "2.0", "FACTOR"),
    "in_tuple_offset": ("1.0", "2.0"),
    "recursion_start": ("x", "-x"),
    "arguments": ("a, b", "b, a", "a, b, /"),
    "default": ("3.0", "-3.0", "3"),
    "keyword_default": ("0.5", "0.25"),
    "inner_constant": ("1.0", "2.0"),
    "inner_global": ("FACTOR", "LATE"),
    "local": ("speed", "length"),
    "literal": ("0.0", "-0.0", "0", "1.0", "1", "True"),
    "member_set": ("(1, 2)", "{1, 2}", "{1, 2.0}", "{1, 3}"),
    "closed_offset": ("1.0", "2.0"),
    "gain": ("2.0", "2", "-2.0"),
    "table": ("np.array([5.0])", "np.array([6.0])", "(5.0,)"),
    "far_factor": ("2.0", "3.0"),
    "near_factor": ("2.0", "3.0"),
}
SHIPPED = dict.fromkeys(SLOTS, 0)
CHOICES = st.fixed_dictionaries({slot: st.sampled_from(range(len(texts))) for slot, texts in SLOTS.items()})

EntryOf = Callable[..., str]


class Reading(NamedTuple):
    near_m: float
    far_m: float


@pytest.fixture(scope="module")
def entry_of(tmp_path_factory: pytest.TempPathFactory) -> EntryOf:
    """(function, signature) -> the name of its entry's file."""
    numbers = count()
    base = tmp_path_factory.mktemp("entries")

    def entry(function: Any, signature: Any = "()") -> str:
        folder = base / str(next(numbers))
        KernelCache(function, folder).save_overload(signature, Result())
        [path] = folder.iterdir()
        return path.name

    return entry


def built(choice: dict[str, int], late: str = "1.0", lines_above: int = 0, file: str = "module.py") -> Any:
    """The kernel `step` of the source with these texts in its slots."""
    texts = {slot: SLOTS[slot][at] for slot, at in choice.items()}
    modules = [ModuleType(name) for name in ("module", "helpers", "helpers.deep")]
    for module, template in zip(modules, (SOURCE, HELPERS, DEEP), strict=True):
        source = "\n" * lines_above + template.substitute(texts, late_constant=late)
        exec(compile(source, file, "exec"), module.__dict__)
    module, helpers, deep = modules
    helpers.__dict__["deep"] = deep
    module.__dict__["helpers"] = helpers
    return module.__dict__["step"]


def closing_over(value: Any) -> Callable[[], Any]:
    return lambda: value


@pytest.mark.parametrize("slot", SLOTS)
def test_each_edit_gives_another_entry(entry_of: EntryOf, slot: str) -> None:
    entries = [entry_of(built({**SHIPPED, slot: at})) for at in range(len(SLOTS[slot]))]
    assert len(set(entries)) == len(entries), dict(zip(SLOTS[slot], entries, strict=True))
    assert entries[0] == entry_of(built(SHIPPED))


@given(CHOICES, st.sampled_from([(slot, at) for slot, texts in SLOTS.items() for at in range(len(texts))]))
def test_an_edit_gives_another_entry_whatever_else_was_edited(
    entry_of: EntryOf, choice: dict[str, int], edit: tuple[str, int]
) -> None:
    slot, at = edit
    same = choice[slot] == at
    assert (entry_of(built(choice)) == entry_of(built({**choice, slot: at}))) == same


@given(CHOICES, st.integers(0, 5), st.sampled_from(["module.py", "moved/module.py"]))
def test_the_same_source_at_another_line_or_path_gives_the_same_entry(
    entry_of: EntryOf, choice: dict[str, int], lines_above: int, file: str
) -> None:
    assert entry_of(built(choice)) == entry_of(built(choice, lines_above=lines_above, file=file))


@pytest.mark.parametrize(("global_read", "same"), [("LATE", False), ("FACTOR", True)])
def test_only_globals_that_are_read_count(entry_of: EntryOf, global_read: str, same: bool) -> None:
    choice = {**SHIPPED, "inner_global": SLOTS["inner_global"].index(global_read)}
    assert (entry_of(built(choice)) == entry_of(built(choice, late="2.0"))) == same


NUMBERS = st.integers(-2, 2) | st.booleans() | st.floats(width=16) | st.sampled_from([0.0, -0.0, 1.0, -math.nan])
SCALARS = NUMBERS | NUMBERS.map(np.float64) | NUMBERS.map(complex) | st.none() | st.text(max_size=2)
VALUES = st.recursive(
    SCALARS, lambda inner: st.lists(inner, max_size=3) | st.tuples(inner, inner) | st.builds(Reading, inner, inner)
)


def spelled(value: Any) -> Any:
    """The exact types and bits of a value of VALUES."""
    if isinstance(value, (tuple, list)):
        return type(value), [spelled(item) for item in value]
    if isinstance(value, complex):
        return type(value), struct.pack("<dd", value.real, value.imag)
    return type(value), struct.pack("<d", value) if isinstance(value, float) else value


@given(VALUES, VALUES)
def test_values_share_an_entry_only_when_types_and_bits_are_equal(entry_of: EntryOf, a: Any, b: Any) -> None:
    same = spelled(a) == spelled(b)
    assert (entry_of(closing_over(a)) == entry_of(closing_over(b))) == same


ARRAYS = st.builds(
    lambda data, dtype, shape, order: np.frombuffer(data, dtype).reshape(shape).copy(order),
    st.sampled_from([bytes(48), bytes(47) + b"\1"]),
    st.sampled_from(["<f8", ">f8", "<i8", "<u8", "<M8[s]"]),
    st.sampled_from([(6,), (2, 3), (3, 2), (1, 6)]),
    st.sampled_from(["C", "F"]),
)


@given(ARRAYS, ARRAYS)
def test_arrays_share_an_entry_only_when_content_type_shape_and_layout_are_equal(
    entry_of: EntryOf, a: np.ndarray, b: np.ndarray
) -> None:
    facts = [
        (array.tobytes(), array.dtype.str, array.shape, array.flags.c_contiguous, array.flags.f_contiguous)
        for array in (a, b)
    ]
    assert (entry_of(closing_over(a)) == entry_of(closing_over(b))) == (facts[0] == facts[1])


def test_records_of_the_arguments_count_with_their_fields(entry_of: EntryOf) -> None:
    from numba import typeof

    def signature(argument: Any) -> Any:
        return (typeof(argument),)

    records = [namedtuple("Record", fields) for fields in ("near_m far_m", "far_m near_m", "near_m length_m")]
    arguments = [kind(1.0, last) for kind in records for last in (2.0, 2, np.zeros(2), np.zeros((2, 1)))]
    arguments += [(1.0, argument) for argument in arguments]
    entries = [entry_of(closing_over(1.0), signature(argument)) for argument in arguments]
    assert len(set(entries)) == len(entries)
    assert entries[0] == entry_of(closing_over(1.0), signature(namedtuple("Record", "near_m far_m")(1.0, 2.0)))


def test_options_of_the_compiler_count(entry_of: EntryOf) -> None:
    from numba import njit

    function = built(SHIPPED)
    choices: list[dict[str, Any]] = [{}, {"error_model": "numpy"}, {"fastmath": True}]
    entries = {entry_of(njit(**options)(function)) for options in choices}
    assert len(entries | {entry_of(function)}) == 4
    assert entry_of(closing_over(njit(function))) != entry_of(closing_over(njit(fastmath=True)(function)))
    assert entry_of(njit(built(SHIPPED))) == entry_of(njit(function))


def test_globals_count_as_they_are_at_the_compilation(tmp_path: Any) -> None:
    module = ModuleType("module")
    exec("def step():\n    return LATE", module.__dict__)
    cache = KernelCache(module.__dict__["step"], tmp_path)
    for value in (1.0, 2.0, 1.0):
        module.__dict__["LATE"] = value
        cache.save_overload("()", Result())
    assert len(list(tmp_path.iterdir())) == 2


def test_a_kernel_that_reads_what_cannot_be_described_is_not_stored(tmp_path: Any) -> None:
    cache = KernelCache(closing_over(threading.Lock()), tmp_path / "kernels")
    cache.save_overload("()", Result())
    assert cache.load_overload("()", Context()) is None and not (tmp_path / "kernels").exists()


def test_a_function_that_closes_over_itself_is_described(entry_of: EntryOf) -> None:
    def made(step: float) -> Any:
        def down(n: float) -> float:
            return n if n < 0.0 else down(n - step)

        return down

    assert entry_of(made(1.0)) == entry_of(made(1.0)) != entry_of(made(2.0))
