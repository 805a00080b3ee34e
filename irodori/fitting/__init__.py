"""Fit of the reflection model, equation (5), to the observations of each texel [eq. 7]."""
