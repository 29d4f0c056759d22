"""Old name of `cellsys.response.eigenvalue_loci`."""

from cellsys.renamed import old_names

__getattr__ = old_names(__name__)
