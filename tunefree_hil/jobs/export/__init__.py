"""`export`: the gains and the open-loop map of a run in the files of another stack, one module per target.

`values.py` collects them, a target module turns them into files, `export.py` writes the folder. What a target has no
place for is in its `not_exported.md` (`remarks.py`), never dropped.
"""
