"""Parameters that elements of bonds read, whichever effect sets them."""

from __future__ import annotations

from cellsys.effects.protocol import Effect


class ClutchLaw(Effect):
    """An effect with the parameters of a motor clutch [notes: mechanics, clutch]."""

    stiffness: float  # pN/um
    zipper: float  # pN/um
    on_rate: float  # 1/s
    off_rate: float  # 1/s
    force_scale: float  # pN
    retrograde_speed: float  # um/s
    height: float  # um
    width: float  # um
    reach: float  # um
    reinforcement: float
    reinforcement_stiffness: float  # pN/um


class ClusterLaw(Effect):
    """An effect with the parameters of Bell clusters [notes: mechanics, clusters]."""

    bonds: float
    bond_stiffness: float  # pN/um
    rest_length: float  # um
    bind_distance: float  # um
    bind_rate: float  # 1/s
    gain_rate: float  # 1/s
    loss_rate: float  # 1/s
    bond_force: float  # pN
    contraction_speed: float  # um/s
    stall_force: float  # pN
