"""What a user wrote, in the batch: it may be written in what the compiler does not take, and is told so by name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import compiler_errors
from tunefree_hil.bench.load import Bench
from tunefree_hil.bench.user_parts import part_names
from tunefree_hil.config.schema import ModelSpec


class Own(NamedTuple):
    """A plant or a controller part from a file: 'path/to/file.py:EXPORT', and where it is named."""

    name: str
    file: str
    key: str


def own_of(bench: Bench, model: ModelSpec) -> list[Own]:
    """The plant and the parts that are not ours."""
    plant = Own(model.plant.kind, f"{model.folder}/model.toml", "plant.kind")
    parts = [Own(name, bench.file, f"controller.{key}") for key, name in part_names(bench)._asdict().items()]
    return [one for one in (plant, *parts) if ":" in one.name]


def answer_of(kernel: Callable[..., Any], args: tuple[Any, ...], user_kernels: Sequence[Own]) -> Any:
    """`kernel(*args)`. Raises InputError where one with code of the user's cannot be compiled; ours can, so without
    any the compiler's own words are a mistake of ours and pass.
    """
    if not user_kernels:
        return kernel(*args)
    try:
        return kernel(*args)
    except compiler_errors() as error:
        raise InputError(
            f"{' and '.join(one.name for one in user_kernels)} cannot be compiled, so the batch does not drive it",
            code="not_in_batch",
            file=user_kernels[0].file,
            key=user_kernels[0].key,
            hint="drive it over the bus, or write its blocks as kernels (base/kernel.py)",
        ) from error
