"""Principal components of one spectral image [section 7 of the paper].

The image is read twice, tile by tile: for its second moments, then for its coefficients. The rank of an image recovered
from a few bands is the number of these bands. Its decomposition is a problem of that size, and its spectra of 61
wavelengths are never built.
"""
