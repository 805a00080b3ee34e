"""Rough reflection of the environment by look-up [eq. 5, 9].

``maps`` looks up; ``lobes`` is its table, made once by ``fit``; ``cells`` sums the lobes that are too wide for the
table; ``errors`` compares all of it with the true lobe.
"""
