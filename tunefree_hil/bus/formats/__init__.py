"""Log formats other than candump text: one file a format, each with a rows.Format. `find.py` detects them."""
