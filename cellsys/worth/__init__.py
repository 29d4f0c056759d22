"""What a model is worth: errors, roll-outs, baselines, floors, price."""

from cellsys.worth.assessment import assess

__all__ = ["assess"]
