"""Floor 0: the words that every other floor shares. No I/O here."""
