"""Eigenvalues, triangular and Hessenberg forms, singular values, and the solves that use them."""
