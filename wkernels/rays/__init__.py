"""Rays to the light, one by one or all of a receiver's at once, and proofs that need none.

Begin with ``single_rays``; ``caster_tree`` and ``shaft_rays`` are the reference's way.
"""
