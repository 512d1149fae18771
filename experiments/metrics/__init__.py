"""What is measured of a picture and of a sequence of them.

Begin with ``registry``: the table of metrics by name. ``measured`` is what they are given; ``map_metrics`` and
``shadow_scores`` are groups of them, ``shadow_classes`` and ``carry_over`` what they need.
"""
