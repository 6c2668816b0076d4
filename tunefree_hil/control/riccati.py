"""Discrete algebraic Riccati equation for one input, in plain floats: loops over flat row-major buffers.

Without a linear-algebra library, as its order of operations may change between versions and gains must not.

Two solvers of the same equation P = Q + A'PA - A'PB (r + B'PB)^-1 B'PA:
`recurse` is the plain recursion as shipped (docs/reference/apollo.md), which stops by tolerance or after 150 rounds; up
to 12 m/s the cap stops it, so its gains are not those of the equation. `double` is structured doubling: each round
doubles the number of recursion rounds, and it converges to rounding error.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from tunefree_hil.base.kernel import buffer, kernel

SHIPPED_ROUNDS = 150
SHIPPED_TOLERANCE = 0.01
DOUBLINGS = 60  # the recursion's rounds grow as 2^n: 12 to 20 are needed
DOUBLING_TOLERANCE = 1e-15


@kernel
def multiply(out: Any, left: Any, right: Any, n: int) -> None:
    """out = left right."""
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += left[i * n + k] * right[k * n + j]
            out[i * n + j] = total


@kernel
def multiply_transposed_left(out: Any, left: Any, right: Any, n: int) -> None:
    """out = left' right."""
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += left[k * n + i] * right[k * n + j]
            out[i * n + j] = total


@kernel
def multiply_transposed_right(out: Any, left: Any, right: Any, n: int) -> None:
    """out = left right'."""
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += left[i * n + k] * right[j * n + k]
            out[i * n + j] = total


@kernel
def solve(matrix: Any, right: Any, n: int, columns: int) -> bool:
    """right = matrix^-1 right by elimination with row pivoting, both overwritten; False where matrix is singular."""
    for pivot in range(n):
        best = pivot
        for i in range(pivot + 1, n):
            if abs(matrix[i * n + pivot]) > abs(matrix[best * n + pivot]):
                best = i
        if matrix[best * n + pivot] == 0.0:
            return False
        if best != pivot:
            for j in range(n):
                matrix[pivot * n + j], matrix[best * n + j] = matrix[best * n + j], matrix[pivot * n + j]
            for j in range(columns):
                swapped = right[pivot * columns + j]
                right[pivot * columns + j] = right[best * columns + j]
                right[best * columns + j] = swapped
        scale = 1.0 / matrix[pivot * n + pivot]  # not 0: checked above
        for i in range(n):
            if i != pivot:
                share = matrix[i * n + pivot] * scale
                if share != 0.0:
                    for j in range(pivot, n):
                        matrix[i * n + j] -= share * matrix[pivot * n + j]
                    for j in range(columns):
                        right[i * columns + j] -= share * right[pivot * columns + j]
    for i in range(n):
        scale = 1.0 / matrix[i * n + i]  # not 0: it was a pivot
        for j in range(columns):
            right[i * columns + j] *= scale
    return True


@kernel
def fill_gain(gain: Any, p: Any, a: Any, b: Any, weight: float, n: int) -> None:
    """gain = (r + B'PB)^-1 B'PA, a row of n."""
    middle = weight
    for i in range(n):
        for j in range(n):
            middle += b[i] * p[i * n + j] * b[j]
    for j in range(n):
        total = 0.0
        for i in range(n):
            for k in range(n):
                total += b[i] * p[i * n + k] * a[k * n + j]
        gain[j] = total / middle if middle != 0.0 else 0.0


@kernel
def recurse(
    p: Any, a: Any, b: Any, q: Any, weight: float, n: int, rounds: int, tolerance: float, work: Any, row: Any
) -> int:
    """Plain recursion from P = Q into p; the rounds it took. work: n n, row: n.

    As in Apollo it stops when the absolute value of the *largest* coefficient of the change (not the largest absolute
    value) is within the tolerance, or after the last round.
    """
    for i in range(n * n):
        p[i] = q[i]
    for count in range(rounds):
        multiply(work, p, a, n)
        middle = weight
        for j in range(n):
            total = 0.0
            for i in range(n):
                total += b[i] * work[i * n + j]
            row[j] = total
        for i in range(n):
            for j in range(n):
                middle += b[i] * p[i * n + j] * b[j]
        scale = 1.0 / middle if middle != 0.0 else 0.0
        largest = -1e300
        for i in range(n):
            for j in range(n):
                total = q[i * n + j] - row[i] * row[j] * scale
                for k in range(n):
                    total += a[k * n + i] * work[k * n + j]
                change = total - p[i * n + j]
                if change > largest:
                    largest = change
                p[i * n + j] = total
        if abs(largest) <= tolerance:
            return count + 1
    return rounds


@kernel
def double(
    h: Any, a: Any, g: Any, n: int, rounds: int, tolerance: float, w: Any, v: Any, t: Any, left: Any, pair: Any
) -> int:
    """Structured doubling: h starts as Q and becomes P; a, g = B B'/r are overwritten. Returns the number of rounds.

    With W = (I + G H)^-1: A+ = A W A, G+ = G + A W G A', H+ = H + A' H W A. w, v, t, left: n n; pair: 2 n n.
    """
    for count in range(rounds):
        multiply(left, g, h, n)
        for i in range(n):
            left[i * n + i] += 1.0
            for j in range(n):
                pair[i * 2 * n + j] = a[i * n + j]
                pair[i * 2 * n + n + j] = g[i * n + j]
        if not solve(left, pair, n, 2 * n):
            return rounds
        for i in range(n):
            for j in range(n):
                w[i * n + j] = pair[i * 2 * n + j]  # W A
                v[i * n + j] = pair[i * 2 * n + n + j]  # W G
        multiply(t, h, w, n)
        multiply_transposed_left(left, a, t, n)  # A' H W A
        largest, change = 0.0, 0.0
        for i in range(n):
            for j in range(n):
                step = 0.5 * (left[i * n + j] + left[j * n + i])
                h[i * n + j] += step
                if abs(step) > change:
                    change = abs(step)
                if abs(h[i * n + j]) > largest:
                    largest = abs(h[i * n + j])
        multiply(t, a, v, n)
        multiply_transposed_right(left, t, a, n)  # A W G A'
        for i in range(n):
            for j in range(n):
                g[i * n + j] += 0.5 * (left[i * n + j] + left[j * n + i])
        multiply(t, a, w, n)
        for i in range(n * n):
            a[i] = t[i]
        if change <= tolerance * largest:
            return count + 1
    return rounds


class RiccatiBuffers(NamedTuple):
    """Buffers that `converge` overwrites: six of n n, one of 2 n n, one of n."""

    g: Any
    used: Any
    w: Any
    v: Any
    t: Any
    left: Any
    pair: Any
    row: Any


def make_buffers(n: int) -> RiccatiBuffers:
    """The buffers for n states."""
    squares = [buffer(n * n) for _ in range(6)]
    return RiccatiBuffers(*[*squares, buffer(2 * n * n), buffer(n)])


@kernel
def solve_gain(
    gain: Any, p: Any, a: Any, b: Any, q: Any, weight: float, n: int, shipped: bool, work: RiccatiBuffers
) -> int:
    """K into gain, P into p, for flat A (n n), B (n), Q (n n) and the weight r of the one input; the rounds it took.

    `shipped`: the recursion with its cap; else the converged solution. a, b, q are not changed.
    """
    if shipped:
        rounds = recurse(p, a, b, q, weight, n, SHIPPED_ROUNDS, SHIPPED_TOLERANCE, work.w, work.row)
    else:
        inverse = 1.0 / weight if weight != 0.0 else 0.0
        for i in range(n):
            for j in range(n):
                index = i * n + j
                p[index], work.used[index], work.g[index] = q[index], a[index], b[i] * b[j] * inverse
        rounds = double(
            p, work.used, work.g, n, DOUBLINGS, DOUBLING_TOLERANCE, work.w, work.v, work.t, work.left, work.pair
        )
    fill_gain(gain, p, a, b, weight, n)
    return rounds


class RiccatiSolution(NamedTuple):
    """K (n), P (n n, by rows) and the rounds that the solver took."""

    gain: list[float]
    p: list[float]
    rounds: int


def gain(a: Any, b: Any, q: Any, weight: float, shipped: bool) -> RiccatiSolution:
    """Solve one system, as `solve_gain`."""
    n = len(b)
    row, p = buffer(n), buffer(n * n)
    rounds = solve_gain(row, p, a, b, q, weight, n, shipped, make_buffers(n))
    return RiccatiSolution([float(value) for value in row], [float(value) for value in p], int(rounds))
