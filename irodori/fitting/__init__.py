"""Per-texel fit of equation (5) to a texel's observations: equation (7) and what follows from it."""
