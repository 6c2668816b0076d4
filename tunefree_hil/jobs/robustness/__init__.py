"""The road sweep: the winner of a tune and the manual sets, on many fresh roads and in many cars."""
