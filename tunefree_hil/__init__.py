"""A hardware-in-the-loop bench that tunes the controllers of a by-wire vehicle over CAN."""

__version__ = "0.1.0"
