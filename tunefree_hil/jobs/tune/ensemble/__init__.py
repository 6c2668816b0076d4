"""The ensemble of cars of a search: what it is, how candidates drive it, and the choice of the winner."""
