"""Our own bus (docs/reference/design.md): one hub process, any number of peers, two channels, one order.

`hub.py` routes and orders, `plugin.py` is the interface for python-can, `owner.py` the control connection,
`records.py` the format between them. `python -m tunefree_hil.bus.tfhub` starts a hub.
"""
