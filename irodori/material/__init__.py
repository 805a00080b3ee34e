"""Materials: parameter maps, principal components and their coefficients."""
