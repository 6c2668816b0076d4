"""A user's own plant in the batch: it may be written in what the compiler does not take, and is told so by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import compiler_errors
from tunefree_hil.config.schema import ModelSpec


def answer_of(kernel: Callable[..., Any], args: tuple[Any, ...], model: ModelSpec) -> Any:
    """`kernel(*args)`. Raises InputError where a plant from a file ('path/to/file.py:EXPORT') cannot be compiled; the
    shipped kinds can, so with them the compiler's own words are a mistake of ours and pass.
    """
    kind = model.plant.kind
    if ":" not in kind:
        return kernel(*args)
    try:
        return kernel(*args)
    except compiler_errors() as error:
        raise InputError(
            f"the plant {kind} cannot be compiled, so the batch does not drive it",
            code="not_in_batch",
            file=f"{model.folder}/model.toml",
            key="plant.kind",
            hint="drive it over the bus, or write its blocks as kernels (base/kernel.py)",
        ) from error
