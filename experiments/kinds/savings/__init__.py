"""Kind ``savings``: what leaving out work saves, rule by rule."""
