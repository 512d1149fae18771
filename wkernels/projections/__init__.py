"""Where a light looks: views fitted to what is seen, split, warped or stabilised.

Begin with ``light_views``, which covers all receivers; ``focusing`` covers what the eye sees, ``splits`` divides it.
"""
