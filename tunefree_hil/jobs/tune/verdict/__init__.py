"""What a verdict comes to: sentences, a table of the requirements, and best.toml."""
