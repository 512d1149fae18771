"""Techniques that put an outer penumbra round the hard shadow, from the silhouettes seen from the light, a file each.

Begin with ``plateaus``. ``_silhouette_maps`` is no technique but what those share that draw the penumbra into a map.
"""
