"""How many cars an ensemble may have: apart, as the options of commands import it and must start fast."""

MOST_CARS = 64
