"""The image of layers against ``host_locate``'s rule, pixel by pixel."""

from __future__ import annotations

import numpy as np
import small_scenes
from light_map_probe import host_locate

from wkernels.analysis.light_layers import chosen_layers
from wkernels.frame.session import Session
from wkernels.scene.geometry import RECEIVES, Geometry


def test_every_pixel_has_the_layer_that_holds_it_most_centrally(device: str) -> None:
    scene = small_scenes.scene(
        [
            small_scenes.mesh("floor", small_scenes.plane(12.0)),
            small_scenes.mesh("back", small_scenes.box((0.0, 3.0, -5.0), (12.0, 6.0, 0.5))),
            small_scenes.mesh("box", small_scenes.box((0.5, 1.0, 0.0), (1.0, 1.0, 1.0)), receives=False),
        ],
        small_scenes.light("point", (0.0, 2.5, 0.5)),  # amid what receives: six faces
    )
    session = Session(Geometry(scene, device), width=40, height=30, device=device)
    light_map, gbuffer = session.light_map(32).map, session.gbuffer()
    assert light_map.layers == 6
    layers = chosen_layers(gbuffer, light_map, device)
    flags, points = gbuffer.flags.numpy(), gbuffer.position_ws.numpy().reshape(-1, 3).astype(float)
    inside = host_locate(session.shown.views, points, 32)[2]
    expected = np.where(inside.max(axis=1) >= 0.0, inside.argmax(axis=1), -1).reshape(layers.shape)
    ordered = np.sort(inside, axis=1)
    # float32 may decide otherwise where two faces hold a point equally well
    clear = (ordered[:, -1] - ordered[:, -2] > 1e-4).reshape(layers.shape)
    receives = (flags & RECEIVES) != 0
    np.testing.assert_array_equal(layers[receives & clear], expected[receives & clear])
    assert (layers[~receives] == -1).all() and (~receives).any()
    assert len(set(layers[receives].tolist())) >= 3
