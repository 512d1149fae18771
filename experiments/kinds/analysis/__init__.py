"""Kind ``analysis``: aliasing error along the view, from formulas alone."""
