"""Tables of a bench file that say what a search is for."""
