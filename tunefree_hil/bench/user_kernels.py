"""Kernels of the user in the batch: an error of the compiler is reported with their names."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import compiler_errors
from tunefree_hil.bench.load import Bench
from tunefree_hil.bench.user_parts import part_names
from tunefree_hil.config.schema import ModelSpec
from tunefree_hil.control.build import load_parts


class UserKernel(NamedTuple):
    """A plant or a controller part from a file: 'path/to/file.py:EXPORT', and the key that names it."""

    name: str
    file: str
    key: str


def list_user_kernels(bench: Bench, model: ModelSpec) -> list[UserKernel]:
    """The plant and the controller parts of the user."""
    plant = UserKernel(model.plant.kind, f"{model.folder}/model.toml", "plant.kind")
    parts = [UserKernel(name, bench.file, f"controller.{key}") for key, name in part_names(bench)._asdict().items()]
    return [kernel for kernel in (plant, *parts) if ":" in kernel.name]


def require_kernel_parts(bench: Bench) -> None:
    """Raise InputError for a part of the controller that cannot be compiled."""
    names = part_names(bench)
    for (key, name), part in zip(names._asdict().items(), load_parts(names), strict=True):
        if not getattr(part, "is_kernel", True):
            raise InputError(
                f"{name} is not compiled, so the batch does not drive it",
                code="not_in_batch",
                file=bench.file,
                key=f"controller.{key}",
                hint="drive it over the bus: leave out --backend batch",
            )


def run_kernel(kernel: Callable[..., Any], args: tuple[Any, ...], user_kernels: Sequence[UserKernel]) -> Any:
    """Call `kernel(*args)`. Raises InputError where it cannot be compiled with the user's kernels; without any the
    error of the compiler is raised.
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
