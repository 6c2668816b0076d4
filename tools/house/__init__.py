"""Counts what the house rules limit: names, lengths of files and functions, references, words."""
