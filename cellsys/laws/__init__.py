"""The physics written once: array functions that take numpy or CasADi."""
