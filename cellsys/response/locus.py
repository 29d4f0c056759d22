"""Old name of `cellsys.response.root_locus`."""

from cellsys.renamed import old_names

__getattr__ = old_names(__name__)
