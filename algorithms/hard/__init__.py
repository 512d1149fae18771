"""Techniques that show the hard shadow of a light's centre, a file each.

Begin with ``shadow_map``; ``alias_free`` and ``projection_shadows`` do without a map, ``blob_shadows`` without shapes.
"""
