"""The exam of the workflow that names what a simulation lacks: cars, drives, hidden effects, sealing, running, scoring.

It is written from the descriptions of docs/reference/effects.md alone and shares no code with the package that it
examines; neither
may import the other (tests/tools/gap_exam/test_apart.py). What goes out of it is what a car would give: CAN logs and a
vehicle folder.
"""
