"""Techniques that count the faces of shadow volumes between the eye and what it sees, a file each.

Begin with ``shadow_volume_zfail``. ``_hard_volumes`` is no technique but what they share.
"""
