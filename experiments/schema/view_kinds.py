"""The kinds of views: their titles and what they show, for pictures, reports and ``explain``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from wkernels.workspace.products import Product


@dataclass(frozen=True)
class Kind:
    """One kind of picture.

    Attributes:
        title: Heading.
        caption: What to look for, one or two sentences.
        places: Where it is looked at from: ``eye``, ``third`` (person), or ``map`` (no camera).
        needs_map: Whether it says something about a light map, so that other techniques have none.
        pulls: Product that it is about, so that techniques that do not pull it have none.
    """

    title: str
    caption: str
    places: tuple[str, ...]
    needs_map: bool = True
    pulls: Product | None = None


KINDS: Mapping[str, Kind] = {
    "texel_borders": Kind(
        "Texel borders",
        "The light map's texel grid on the surfaces that read it. Cells that are large on the screen are what makes "
        "shadow edges jagged; where they change size along the view is what a warp or a split does.",
        ("eye", "third"),
    ),
    "split_colours": Kind(
        "Split colours",
        "The split, or layer, that each receiver reads: red, yellow, green, blue, again (Stingl 2011, equation 5.1).",
        ("eye", "third"),
    ),
    "sampling_frequency": Kind(
        "Sampling frequency",
        "Map texels per pixel of the eye: green is one, red too few (jagged edges), blue more than can be seen. In the "
        "third-person view it is still the eye's rate, faint where the eye cannot see the surface.",
        ("eye", "third"),
    ),
    "difference": Kind(
        "Difference",
        "Visibility minus the ray-cast one: blue is too dark, red too light.",
        ("eye", "third"),
        needs_map=False,
    ),
    "intersection_bodies": Kind(
        "Intersection bodies",
        "Per split the body B that holds all light rays to what the eye sees, and its axis-aligned box: what the map "
        "has to cover and what may cast into it.",
        ("third",),
    ),
    "frusta": Kind(
        "View frustum",
        "The eye's frustum, cut to the depths that the maps cover, its splits, and the way to the light.",
        ("third",),
        needs_map=False,
    ),
    "minimap": Kind(
        "Minimap",
        "Where the eye stands and what it sees from there.",
        ("third",),
        needs_map=False,
    ),
    "light_views": Kind(
        "Light views",
        "The scene as each map sees it, with the frustum and the view vector in it: a warp spreads what is near to the "
        "eye.",
        ("map",),
    ),
    "silhouettes": Kind(
        "Silhouettes",
        "The casters' edges where the light's centre sees them turn away, in the loops that shadow volumes and "
        "penumbrae are swept from.",
        ("eye", "third"),
        needs_map=False,
        pulls=Product.SILHOUETTES,
    ),
    "wedges": Kind(
        "Penumbra wedges",
        "Bodies in which silhouette edges cover or uncover a part of the light, a few of each caster's: behind the "
        "edge, between the ways from the light's border through its ends.",
        ("third",),
        needs_map=False,
        pulls=Product.WEDGES,
    ),
    "v_buffer": Kind(
        "V-buffer",
        "What the inner halves of wedges add to the hard shadow, what the outer halves take from the light, and how "
        "many wedges do either in a pixel.",
        ("eye",),
        needs_map=False,
        pulls=Product.WEDGES,
    ),
    "depth_map": Kind("Depth maps", "Linear depth from the light, layer by layer.", ("map",)),
    "shadow_area_waste": Kind(
        "Wasted shadow-map area",
        "What the texels are spent on: read by a pixel of the eye, within the body that the eye sees but read by none, "
        "or outside it.",
        ("map", "third"),
    ),
    "perspective_error": Kind(
        "Perspective aliasing error",
        "Pixels that a texel spans along the view vector, across (m_x) and along it (m_z): above 1 the map is too "
        "coarse.",
        ("map",),
    ),
}


def picture_names(kind: str, modes: list[str]) -> list[str]:
    """Names of the files that a kind gives, without frame and suffix."""
    stems = [f"{kind}_{mode}" for mode in modes] if kind == "sampling_frequency" else [kind]
    return [stem if place == "map" else f"{stem}_{place}" for stem in stems for place in KINDS[kind].places]


def kind_of(name: str) -> str | None:
    """The kind that a picture's name belongs to; None where there is none."""
    return next((kind for kind in KINDS if name == kind or name.startswith(f"{kind}_")), None)
