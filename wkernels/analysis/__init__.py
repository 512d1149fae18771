"""Error analysis, for experiments only: no technique reads it.

Begin with ``perspective_error``, the closed forms; ``sampling_rate`` measures the same of a map that was drawn.
"""
