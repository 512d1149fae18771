"""What every method with a light map asks first of a pixel: is there a comparison to make, and where in the map."""

from __future__ import annotations

import warp as wp

from wkernels.light_maps.light_map import Bias, LightMap, Receiver, locate_receiver
from wkernels.raster.gbuffer import GBuffer, is_back_lit, to_light
from wkernels.scene.geometry import RECEIVES


@wp.func
def receiver_of_pixel(gbuffer: GBuffer, light_map: LightMap, bias: Bias, y: int, x: int):
    """The pixel's receiver in the map; layer -1 where its visibility is known without one, and then ``visible`` is it.

    That is 1 where nothing receives or no layer covers the point, and 0 where the surface itself hides the light.
    """
    receiver = Receiver()
    receiver.layer = -1
    receiver.visible = 1.0
    if (gbuffer.flags[y, x] & RECEIVES) != 0:
        position_ws = gbuffer.position_ws[y, x]
        if is_back_lit(gbuffer, y, x, to_light(light_map.light_ws, position_ws)):
            receiver.visible = 0.0
        else:
            receiver = locate_receiver(light_map, bias, position_ws, gbuffer.normal_ws[y, x])
    return receiver
