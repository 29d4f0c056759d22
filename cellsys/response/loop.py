"""Old name of `cellsys.response.sensitivity_functions`."""

from cellsys.renamed import old_names

__getattr__ = old_names(__name__)
