"""What an experiment file may say, and what it is resolved to.

Begin with ``experiment``: the resolved form that renderer, results and reports are given. ``models`` are the keys as
they are written, ``techniques`` expands their list, ``needs`` asks whether a scene offers what they need, ``published``
and ``views`` check the keys of these names; ``view_kinds`` names the pictures that ``views`` may ask for.
"""
