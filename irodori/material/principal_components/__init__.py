"""Principal components of one spectral image [section 7 of the paper].

Two passes over tiles of it: second moments, then coefficients. An image recovered from a few bands has their number
as its rank, so its decomposition is a problem of that size: the 61 bands are never built.
"""
