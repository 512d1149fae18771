"""Ray-cast techniques that all others are scored by, a file each.

Begin with ``reference_multisample``; ``ray_cast_point_shadow`` is the reference of hard shadows.
"""
