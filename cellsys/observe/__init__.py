"""Physical read-outs of runs, full-order or reconstructed."""

from cellsys.observe.spreading import contact_radius, node_speed, summary_of_run

__all__ = ["contact_radius", "node_speed", "summary_of_run"]
