"""Small kernels that several packages share."""

from __future__ import annotations

import math
from typing import Any

from tunefree_hil.base.kernel import kernel

TWO_PI = 2.0 * math.pi


@kernel
def clamp(value: float, low: float, high: float) -> float:
    """`value` within [low, high]."""
    if value < low:
        return low
    if value > high:
        return high
    return value


@kernel
def wrap_rad(angle_rad: float) -> float:
    """The same angle within (-pi, pi]."""
    turns = math.floor((math.pi - angle_rad) / TWO_PI)
    return angle_rad + turns * TWO_PI


@kernel
def find_cell_between(grid: Any, low: int, high: int, value: float) -> int:
    """Index i of the cell with grid[i] <= value < grid[i + 1], clamped to low <= i < high; ascending between these."""
    while high - low > 1:
        middle = (low + high) // 2
        if grid[middle] <= value:
            low = middle
        else:
            high = middle
    return low


@kernel
def find_cell(grid: Any, value: float) -> int:
    """Index i of the cell of an ascending grid with grid[i] <= value < grid[i + 1], clamped to the ends."""
    return find_cell_between(grid, 0, len(grid) - 1, value)


@kernel
def lerp_table(grid: Any, values: Any, x: float) -> float:
    """Linear interpolation in an ascending grid, flat outside it."""
    if x <= grid[0]:
        return float(values[0])
    last = len(grid) - 1
    if x >= grid[last]:
        return float(values[last])
    i = find_cell(grid, x)
    width = grid[i + 1] - grid[i]
    if width <= 0.0:
        return float(values[i])
    share = (x - grid[i]) / width
    return float(values[i] + share * (values[i + 1] - values[i]))


@kernel
def is_finite(value: float) -> bool:
    """False for NaN and infinities."""
    return value - value == 0.0
