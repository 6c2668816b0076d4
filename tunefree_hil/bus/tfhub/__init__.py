"""Our own bus (docs/reference/design.md): one hub process, any number of peers, two channels, one order.

`hub.py` routes and orders, `plugin.py` is what python-can opens, `owner.py` the control connection, `records.py` what
passes between them. `python -m tunefree_hil.bus.tfhub` starts a hub.
"""
