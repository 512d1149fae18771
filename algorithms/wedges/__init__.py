"""Techniques that sum over silhouette edges how much of the light each covers or uncovers, a file each.

Begin with ``wedge_spherical``. ``_wedges`` is no technique but what they share; the method is in
``wkernels/casters/wedges``.
"""
