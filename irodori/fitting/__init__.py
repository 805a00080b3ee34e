"""Per-texel fit of equation (5) [eq. 7]."""
