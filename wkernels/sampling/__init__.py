"""Point sets, taps on discs, and what an estimate from few tests is worth.

Begin with ``point_sets``; ``disc_sets`` are the offsets of filters, ``estimators`` the statistics of shadow tests.
"""
