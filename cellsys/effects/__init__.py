"""Effects: one file each, an explicit list, nothing built unless a scene names it.

What an effect of your own is made of stands here; `examples/your_own_effect.py` makes one.
"""

from cellsys.effects.protocol import (
    Configuration,
    Effect,
    Element,
    Held,
    JunctionArray,
    Port,
    Site,
    Stiffness,
    parameter,
)

__all__ = [
    "Configuration",
    "Effect",
    "Element",
    "Held",
    "JunctionArray",
    "Port",
    "Site",
    "Stiffness",
    "parameter",
]
