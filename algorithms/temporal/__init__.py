"""Techniques that remember earlier frames, a file each.

Begin with ``tc_hard``. Files whose names begin with ``_`` are no techniques but what several of them share.
"""
