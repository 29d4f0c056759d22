"""The printed ways to couple cells, through the rows of V that belong to the matrix."""
