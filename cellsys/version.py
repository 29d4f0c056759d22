"""The version of cellsys, in one place; `store` keys depend on it."""

__version__ = "0.2.0"
