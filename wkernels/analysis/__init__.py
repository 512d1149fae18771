"""Error analysis, for experiments only: no technique reads it. Begin with ``perspective_error``."""
