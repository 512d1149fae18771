"""``kind: stability``: every technique on stiff and extreme cases of rising stiffness, and where it breaks.

- ``shapes``: the small scene that all cases are made of;
- ``cases``: the cases X1 to X13, one function each, and their levels;
- ``judge``: what one picture says: finite, in range, how far from the truth beside the easy level;
- ``table``: rows of stability.csv; ``heat_map``: the same as a picture; ``run``: the result folder.
"""
