"""Numbers as text that gives the same number back."""

from __future__ import annotations

from tunefree_hil.control.parameters import LARGEST32, round32

DIGITS = 9  # enough for any binary32 number


def format_number(value: float) -> str:
    """The shortest text that is the same binary32 number, as parameters are; nine digits of a value that is none."""
    if abs(value) > LARGEST32 or round32(value) != value:
        return f"{value:.{DIGITS}g}"
    texts = (f"{value:.{digits}g}" for digits in range(1, DIGITS + 1))
    return next(text for text in texts if round32(float(text)) == value)
