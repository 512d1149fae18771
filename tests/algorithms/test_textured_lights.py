"""What techniques make of a light whose parts do not shine alike."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import small_scenes as small
from sessions import open_session

from algorithms.plugins import find
from wkernels.frame.result import Unread
from wkernels.scene.lights import RectangleLight

NAMES = ("wedge_rectangular", "wedge_textured", "pcss", "multi_shadow_map", "reference_multisample")


def test_a_texture_that_is_not_looked_at_is_told(device: str) -> None:
    """Not of techniques that weigh samples or ask for the texture itself; and one that is constant is none."""
    plain = small.light("rectangle")
    assert isinstance(plain, RectangleLight)
    for texture, told in ((np.array([[0.0, 1.0]]), {"wedge_rectangular", "pcss"}), (np.ones((2, 2)), set())):
        session = open_session(small.box_on_ground(replace(plain, texture=texture)), device, size=(16, 12))
        found = {
            name
            for name in NAMES
            for what, why, _ in session.render(find(name)()).left_out
            if (what, why) == Unread.TEXTURE.pair
        }
        assert found == told
