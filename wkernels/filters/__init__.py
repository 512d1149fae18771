"""Filters over light maps and images: comparisons, moments, sums, neighbours.

Begin with ``penumbra``, percentage-closer filtering, or with ``map_images``, images of any texel type in a map's layout
(``blur``, ``mips``, ``summed_area``). ``pyramid`` knows the range of depths in any window,
``window_proofs`` whether all of it is lit or hidden.
"""
