"""Types and functions that all other packages share. No I/O here, except helper processes and files of parts."""
