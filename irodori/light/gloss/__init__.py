"""Rough reflection of the environment [eq. 5, 9]: maps of blurred light, the table of lobes, and what both err by.

``maps`` looks up; ``lobes`` is its table, made once by ``fit``; ``cells`` sums the lobes that are too wide for the
table; ``errors`` compares all of it with the true lobe.
"""
