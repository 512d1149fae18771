"""``kind: analysis``: perspective aliasing error along the view, from closed forms, without a scene."""
