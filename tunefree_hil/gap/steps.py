"""Steps of a least-squares problem within bounds: the least of a convex quadratic, by active sets."""

from __future__ import annotations

import numpy as np

Array = np.ndarray

# Standard deviations that what numbers come to together may go where the model's own logs have told it
# (gap/own_numbers.py). Freely, five clean logs of development's cars went 1.6 to 3.3, a throttle that gave a tenth less
# 4.8: there recalibration took the place of its name.
MOST_TOGETHER = 3.0
STIFF = 1e4  # times what the data know of a direction: how hard its end is
SLACK = 1.05  # of MOST_TOGETHER: so far a wall that is no harder than that gives way
HELD_TURNS = 6
RELEASES = 4  # turns of a bounded step, for each of its parameters
RELEASED = 1e-9  # of the greatest slope: a pull that is less lets nothing go
FLAT = 1e-6  # added to every curvature: what the data do not feel stays where it is


def walled(curve: Array, slope: Array, z: Array, low: Array, high: Array, walls: Array) -> Array:
    """The same as `bounded`, within MOST_TOGETHER of nought along each of `walls` [w, p] besides: what goes farthest
    beyond one is held there, one after the other, and let go, one after the other, where that pulls it back inside.
    Where they take turns for ever, what was found last is drawn back inside (`drawn_in`).
    """
    stiff = STIFF * (1.0 + np.einsum("wi,ij,wj->w", walls, curve, walls) / np.sum(walls**2, axis=1) ** 2)
    held = np.zeros(len(walls))
    for _ in range(RELEASES * len(walls) + 1):
        by = stiff * np.abs(held)
        more = slope + walls.T @ (by * (walls @ z - MOST_TOGETHER * held))
        step = bounded(curve + (walls.T * by) @ walls, more, z, low, high)
        there = walls @ (z + step)
        inward = np.where(held != 0.0, MOST_TOGETHER - there * held, 0.0)
        beyond = np.where(held == 0.0, np.abs(there) - MOST_TOGETHER, 0.0)
        if inward.max(initial=0.0) > 0.0:
            held[int(np.argmax(inward))] = 0.0
        elif beyond.max(initial=0.0) > 0.0:
            worst = int(np.argmax(beyond))
            held[worst] = np.sign(there[worst])
        else:
            break
    return drawn_in(z + step, walls) - z


def drawn_in(z: Array, walls: Array) -> Array:
    """z, or where it is plainly beyond a wall, what walls know of it drawn back towards nought until it is beyond none:
    there all that is within bounds stays within them.
    """
    far = float(np.abs(walls @ z).max(initial=0.0)) / MOST_TOGETHER
    return np.where((walls != 0.0).any(axis=0), z / far, z) if far > SLACK else z


def bounded(curve: Array, slope: Array, z: Array, low: Array, high: Array) -> Array:
    """The step from z to the least of a convex quadratic within bounds, by an active set: what would go beyond an end
    is held there, and let go again where the rest, once it has moved, pulls it back.
    """
    curve, lowest, highest = curve + FLAT * np.eye(len(z)), low - z, high - z
    step, held = _held_in_turn(curve, slope, lowest, highest)
    least = RELEASED * (1.0 + float(np.abs(slope).max(initial=0.0)))
    for _ in range(RELEASES * len(z)):
        loose = ~held
        pull = -(slope + curve @ step)
        move = np.zeros(len(z))
        move[loose] = np.linalg.solve(curve[np.ix_(loose, loose)], pull[loose])
        end, moving = np.where(move > 0.0, highest, lowest), move != 0.0
        room = np.full(len(z), np.inf)
        room[moving] = (end - step)[moving] / move[moving]
        share = min(float(room.min(initial=np.inf)), 1.0)
        step = np.where(room <= share, end, np.clip(step + share * move, lowest, highest))
        if share < 1.0:
            held |= room <= share
            continue
        pull = -(slope + curve @ step)
        inward = np.where(step <= lowest, pull, 0.0) + np.where(step >= highest, -pull, 0.0)
        inward[~held | (lowest >= highest)] = 0.0
        if inward.max(initial=0.0) <= least:
            break
        held[int(np.argmax(inward))] = False
    return step


def _held_in_turn(curve: Array, slope: Array, lowest: Array, highest: Array) -> tuple[Array, Array]:
    """(a step within bounds, what is held at one): what goes beyond is held there, in turn, and stays. Near the least,
    but of parameters that do nearly the same all may be held that go beyond together, where one would do.
    """
    step, loose = np.zeros(len(slope)), np.ones(len(slope), dtype=bool)
    for _ in range(HELD_TURNS):
        pull = slope[loose] + curve[np.ix_(loose, ~loose)] @ step[~loose]
        step[loose] = -np.linalg.solve(curve[np.ix_(loose, loose)], pull)
        within = np.clip(step, lowest, highest)
        beyond = loose & (within != step)
        step = within
        if not beyond.any():
            break
        loose &= ~beyond
        if not loose.any():
            break
    return step, ~loose
