"""Techniques that render many points of the light and take their mean, a file each.

Begin with ``multi_shadow_map``; ``silhouette_samples`` renders none of them, and is exact.
"""
