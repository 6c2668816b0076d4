"""How many cars an ensemble has, for the schema and for the options of commands, which import no more than they need."""

MOST_CARS = 64
