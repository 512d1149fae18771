"""Penumbra wedges: how much of a light each silhouette edge covers or uncovers, summed over the edges near a pixel.

Begin with ``coverage``, which is the method; ``light_shapes`` says what a light looks like from a point, ``bodies``
where edges matter, ``shading`` sums over a tile's edges. ``docs/wedges.md`` explains it from nothing.
"""
