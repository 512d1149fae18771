"""Filters over light maps and images: comparisons, moments, sums, neighbours.

Begin with ``penumbra``, percentage-closer filtering, or with ``map_images``, images of any texel type in a map's layout
(``blur``, ``mips``, ``summed_area``). ``pyramid`` proves that a whole window is lit or hidden.
"""
