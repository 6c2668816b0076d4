"""Floor 8: the command line. Parses arguments, runs a job of jobs/ and shows its events."""

from tunefree_hil.cli.entry import main

__all__ = ["main"]
