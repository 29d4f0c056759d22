"""Cells reduced by azimuthal symmetry: representation, training, model."""
