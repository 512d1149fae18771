"""Techniques that filter the comparisons or the depths of one light map, a file each.

Begin with ``pcf``. Files whose names begin with ``_`` are no techniques but what several of them share.
"""
