"""A card that is cut out, by hand, from glTF, USD and Mitsuba XML: the same visibility; what cannot be cut is told."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gltf_files import GltfFile
from PIL import Image
from test_importing_gltf import same_visibility

from experiments import reference_visibility
from experiments.scenes import load_scene, primitives
from wkernels.errors import InputError

ALPHA = np.array([[255, 0, 255, 0], [0, 0, 0, 255], [255, 255, 0, 0], [0, 255, 0, 255]], np.uint8)
"""No symmetry hides a texture that is turned or mirrored."""
REST: dict[str, Any] = {
    "lights": [{"kind": "rectangle", "center": [1, 5, 1], "edge_u": [0.4, 0, 0], "edge_v": [0, 0, 0.4]}],
    "camera": {"eye": [0, 7, 6], "target": [0, 0, 0], "fov_deg": 45, "near": 0.5, "far": 60},
}
GROUND = {"primitive": "plane", "size": [8, 8]}


def png(alpha: np.ndarray = ALPHA, *, grey: bool = False) -> bytes:
    out = io.BytesIO()
    pixels = alpha if grey else np.dstack([np.full((*alpha.shape, 3), 90, np.uint8), alpha])
    Image.fromarray(pixels).save(out, "png")
    return out.getvalue()


def by_hand(folder: Path, **mask: Any) -> dict[str, Any]:
    (folder / "leaf.png").write_bytes(png())
    given = {"texture": str(folder / "leaf.png"), "filter": "nearest", **mask}
    card = {"primitive": "plane", "size": [3, 3], "transform": {"translate": [0, 1, 0]}, "mask": given}
    return {"meshes": [GROUND, card], **REST}


def gltf(folder: Path, **material: Any) -> dict[str, Any]:
    """The card with its texture coordinates halved and moved by KHR_texture_transform."""
    file = GltfFile()
    vertices, faces = primitives.plane((3.0, 3.0))
    extension = material.pop("transform", None)
    uv = vertices[:, [0, 2]] / 3.0 + 0.5
    index = file.masked(png(), **material)
    if extension is not None:
        texture = file.json["materials"][index]["pbrMetallicRoughness"]["baseColorTexture"]
        texture["extensions"] = {"KHR_texture_transform": extension}
        turn = extension["rotation"]
        back = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        uv = ((uv - extension["offset"]) @ back.T) / extension["scale"]
    attributes = {"TEXCOORD_0": file.accessor(uv)}
    file.node(mesh=file.mesh(vertices, faces, attributes=attributes, material=index), translation=[0, 1, 0])
    return {"import": str(file.write(folder / "card.gltf")), "meshes": [GROUND], **REST}


def test_gltf_is_cut_as_by_hand(tmp_path: Path) -> None:
    assert same_visibility(gltf(tmp_path), by_hand(tmp_path), samples=4) < 0.97
    whole = by_hand(tmp_path)
    del whole["meshes"][1]["mask"]
    assert not np.array_equal(*(reference_visibility(s, width=64, height=40)[0] for s in (whole, gltf(tmp_path))))


def test_gltf_moves_its_texture_coordinates(tmp_path: Path) -> None:
    """By the inverse of KHR_texture_transform's matrix (Khronos): translation, rotation, scale."""
    moved = gltf(tmp_path, transform={"offset": [0.25, 0.5], "rotation": 0.3, "scale": [2.0, 0.5]})
    same_visibility(moved, by_hand(tmp_path), samples=4)


def test_gltf_multiplies_alpha_and_compares_it_with_the_cutoff(tmp_path: Path) -> None:
    faint = {"baseColorFactor": [1, 1, 1, 0.4]}
    scene = gltf(tmp_path)
    data = Path(scene["import"]).read_text()
    Path(scene["import"]).write_text(
        data.replace('"pbrMetallicRoughness": {', '"pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 0.4], ')
    )
    loaded = load_scene(scene)
    card = next(mesh for mesh in loaded.meshes if mesh.mask is not None)
    assert card.mask is not None and card.mask.cutoff == pytest.approx(0.5 / faint["baseColorFactor"][3])
    empty = reference_visibility(scene, width=64, height=40)[0]
    assert np.nanmin(empty) == 1.0, "alpha of 0.4 is nowhere 0.5"


def test_explain_says_what_is_cut(tmp_path: Path) -> None:
    assert "1 cut out by a texture" in load_scene(gltf(tmp_path)).notes[0]


def test_gltf_without_coordinates_or_blended_is_told_and_opaque(tmp_path: Path) -> None:
    scene = gltf(tmp_path)
    data = Path(scene["import"]).read_text()
    Path(scene["import"]).write_text(data.replace("TEXCOORD_0", "_OTHER"))
    with pytest.warns(UserWarning, match="has no texture coordinates 0; it is drawn opaque"):
        assert all(mesh.mask is None for mesh in load_scene(scene).meshes)
    Path(scene["import"]).write_text(data.replace("MASK", "BLEND"))
    with pytest.warns(UserWarning, match="1 materials with alphaMode BLEND are drawn opaque"):
        assert all(mesh.mask is None for mesh in load_scene(scene).meshes)


STAGE = """\
#usda 1.0
(
    upAxis = "Y"
    metersPerUnit = 1
)
def Mesh "card" ( prepend apiSchemas = ["MaterialBindingAPI"] ) {
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points = [(-1.5, 1, 1.5), (1.5, 1, 1.5), (1.5, 1, -1.5), (-1.5, 1, -1.5)]
    texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] ( interpolation = "INTERPOLATION" )
    rel material:binding = </leaf>
}
def Material "leaf" {
    token outputs:surface.connect = </leaf/surface.outputs:surface>
    def Shader "surface" {
        uniform token info:id = "UsdPreviewSurface"
        float inputs:opacity.connect = </leaf/texture.outputs:CHANNEL>
        float inputs:opacityThreshold = THRESHOLD
        token outputs:surface
    }
    def Shader "texture" {
        uniform token info:id = "UsdUVTexture"
        asset inputs:file = @leaf.png@
        float2 inputs:st.connect = </leaf/reader.outputs:result>
        token inputs:wrapS = "clamp"
        token inputs:wrapT = "clamp"
        float outputs:a
        float outputs:r
    }
    def Shader "reader" {
        uniform token info:id = "UsdPrimvarReader_float2"
        string inputs:varname = "st"
        float2 outputs:result
    }
}
"""


def usd(folder: Path, threshold: float = 0.5, channel: str = "a", interpolation: str = "faceVarying") -> dict[str, Any]:
    words = {"THRESHOLD": f"{threshold}", "CHANNEL": channel, "INTERPOLATION": interpolation}
    text = STAGE
    for word, value in words.items():
        text = text.replace(word, value)
    (folder / "card.usda").write_text(text)
    (folder / "leaf.png").write_bytes(png())
    return {"import": str(folder / "card.usda"), "meshes": [GROUND], **REST}


@pytest.mark.parametrize("interpolation", ["faceVarying", "vertex"])
def test_usd_is_cut_as_by_hand(tmp_path: Path, interpolation: str) -> None:
    pytest.importorskip("pxr")
    scene = by_hand(tmp_path, filter="linear")
    # by hand the texture repeats at its border, in the file it does not: half a texel round the card
    cut, hand = (
        reference_visibility(s, width=64, height=40, samples=4)[0]
        for s in (usd(tmp_path, interpolation=interpolation), scene)
    )
    assert np.nanmean(np.abs(cut - hand) > 1e-6) < 0.03
    shifted = usd(tmp_path, interpolation=interpolation)
    Path(shifted["import"]).write_text(
        Path(shifted["import"]).read_text().replace("(0, 0), (1, 0), (1, 1), (0, 1)", "(0, 1), (1, 1), (1, 0), (0, 0)")
    )
    other = reference_visibility(shifted, width=64, height=40, samples=4)[0]
    assert np.mean(np.abs(np.nan_to_num(other) - np.nan_to_num(hand)) > 1e-6) > 0.06, "upside down it differs"


def test_usd_without_a_threshold_is_told_and_opaque(tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    with pytest.warns(UserWarning, match="surfaces that are transparent are drawn opaque"):
        assert all(mesh.mask is None for mesh in load_scene(usd(tmp_path, threshold=0)).meshes)
    scene = usd(tmp_path)
    (tmp_path / "leaf.png").unlink()
    with pytest.warns(UserWarning, match="has a texture that is missing; it is drawn opaque"):
        load_scene(scene)


def mitsuba(folder: Path, opacity: str) -> dict[str, Any]:
    (folder / "leaf_grey.png").write_bytes(png(grey=True))
    (folder / "card.xml").write_text(
        f"""<scene version="3.0.0"><shape type="rectangle">
        <transform name="to_world"><scale value="1.5"/><rotate x="1" angle="-90"/><translate y="1"/></transform>
        <bsdf type="mask">{opacity}<bsdf type="diffuse"/></bsdf></shape></scene>"""
    )
    return {"import": str(folder / "card.xml"), "meshes": [GROUND], **REST}


BITMAP = """<texture type="bitmap" name="opacity"><string name="filename" value="leaf_grey.png"/>
<string name="filter_type" value="nearest"/><boolean name="raw" value="true"/></texture>"""


def test_mitsuba_is_cut_as_by_hand(tmp_path: Path) -> None:
    flipped = by_hand(tmp_path)
    (tmp_path / "leaf.png").write_bytes(
        png(ALPHA[::-1].copy())
    )  # its first row is at y = -1, which the turn takes to z = +1
    assert same_visibility(mitsuba(tmp_path, BITMAP), flipped, samples=4) < 0.97


def test_mitsuba_masks_that_are_none_are_told(tmp_path: Path) -> None:
    (tmp_path / "leaf.png").write_bytes(png())
    with pytest.warns(UserWarning, match="half transparent throughout are drawn opaque"):
        load_scene(mitsuba(tmp_path, '<float name="opacity" value="0.4"/>'))
    gone = load_scene(mitsuba(tmp_path, '<float name="opacity" value="0"/>'))
    assert np.nanmin(reference_visibility(gone, width=64, height=40)[0]) == 1.0
    with pytest.warns(UserWarning, match="other than an unmoved bitmap on a rectangle"):
        load_scene(mitsuba(tmp_path, '<texture type="checkerboard" name="opacity"/>'))
    with pytest.raises(InputError, match=r"no such file.*gone\.png"):
        load_scene(mitsuba(tmp_path, BITMAP.replace("leaf_grey", "gone")))


def test_a_mask_repeats_and_is_part_of_the_scenes_hash(tmp_path: Path) -> None:
    """Twice as often on a card twice as large looks the same over one period."""
    one, other = load_scene(by_hand(tmp_path)), load_scene(by_hand(tmp_path, repeat=[2, 1]))
    finer, cutoff = load_scene(by_hand(tmp_path, cutoff=0.25)), load_scene(by_hand(tmp_path, filter="linear"))
    assert len({scene.content_hash for scene in (one, other, finer, cutoff)}) == 4
    mask = other.meshes[1].mask
    assert mask is not None and np.ptp(mask.uv, axis=0).tolist() == [2.0, 1.0]


def test_an_image_without_alpha_gives_its_first_channel(tmp_path: Path) -> None:
    scene = by_hand(tmp_path)
    (tmp_path / "leaf.png").write_bytes(png(grey=True))
    mask = load_scene(scene).meshes[1].mask
    assert mask is not None
    np.testing.assert_allclose(mask.alpha, ALPHA / 255.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"texture": "none.png"}, r"mask\.texture: no such file"),
        ({"texture": __file__}, r"mask\.texture: the texture 'test_masks\.py' cannot be read"),
        ({"cutoff": 1.5}, r"mask\.cutoff"),
        ({"repeat": [0, 1]}, r"mask\.repeat"),
        ({"colour": 1}, r"mask\.colour"),
    ],
)
def test_wrong_masks_are_refused(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        load_scene(by_hand(tmp_path, **change))


def test_only_flat_primitives_take_a_mask(tmp_path: Path) -> None:
    scene = by_hand(tmp_path)
    scene["meshes"].append({"primitive": "box", "size": [1, 1, 1], "mask": scene["meshes"][1]["mask"]})
    with pytest.raises(InputError, match="mask"):
        load_scene(scene)
