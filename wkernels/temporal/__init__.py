"""What frames remember of earlier ones, in folders by what is kept.

Begin with ``reprojection``, which all of them share. ``confidence`` remembers a hard shadow and how sure it is,
``shadow_buffer`` sums of tests of one light sample a frame, ``map_pool`` maps of many light samples.
"""
