"""Gloss reflection of the environment on rough surfaces, by look-up in blurred light [eq. 5, 9].

``gloss_maps`` has the look-up, with the tables of ``lobe_table``, which ``make_lobe_table`` makes. ``point_sources``
sums lobes that are too wide for the tables. ``look_up_errors`` compares the results with the exact lobes.
"""
