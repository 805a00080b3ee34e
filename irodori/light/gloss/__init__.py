"""Rough reflection of the environment by look-up [eq. 5, 9].

``gloss_maps`` looks up; ``lobe_table`` has its tables, made by ``make_lobe_table``; ``point_sources`` sums the lobes
that are too wide for the tables; ``look_up_errors`` compares all of it with the true lobes.
"""
