"""The bus: frames and their meaning.

python-can finds `HubBus` by the entry point `tfhub`; it is imported on demand, so that a hub's own
process needs neither python-can nor cantools.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tunefree_hil.bus.tfhub.plugin import HubBus

__all__ = ["HubBus"]


def __getattr__(name: str) -> Any:
    """Import `HubBus` when it is asked for (PEP 562)."""
    if name == "HubBus":
        from tunefree_hil.bus.tfhub.plugin import HubBus

        return HubBus
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
